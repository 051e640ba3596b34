"""The trials of a comparison: sources, methods, start frames, settings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

from slam_init.compare.rows import Key
from slam_init.compare.sources import ComparedSource
from slam_init.compare.trials import Settings, Trial

__all__ = ["Plan"]


@dataclass(frozen=True)
class Plan:
    """The sources and methods of a comparison; its trials are all combinations of source, start frame and method.

    Attributes
    ----------
    sources : tuple of ComparedSource
    methods : tuple of str
        Names as in ``slam-init run --method``.
    every : int
        Step between two start frames.
    settings : Settings
        The folders in it are not used: :func:`slam_init.compare.run.compare` chooses them.
    """

    sources: tuple[ComparedSource, ...]
    methods: tuple[str, ...]
    every: int = 10
    settings: Settings = field(default_factory=Settings)

    def trials(self) -> Iterator[Trial]:
        """Yield all trials. The trials of one source follow one another, so that a process opens the source once.

        Yields
        ------
        Trial
            A method on a source from a start frame.
        """
        for source in self.sources:
            for start in source.starts(self.every):
                for method in self.methods:
                    yield Trial(source, method, start)

    def holds(self, key: Key) -> bool:
        """Return whether a trial belongs to this comparison. A results folder can hold the trials of a wider one.

        Parameters
        ----------
        key : (str, str, int)
            Label of the source, method, start frame.

        Returns
        -------
        bool
            True if this plan contains the trial.
        """
        label, method, start = key
        return method in self.methods and start in self._starts.get(label, ())

    @cached_property
    def _starts(self) -> dict[str, range]:
        return {source.label: source.starts(self.every) for source in self.sources}
