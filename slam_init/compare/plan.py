"""What a comparison runs: sources, methods, starts, settings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

from slam_init.compare.journal import Key
from slam_init.compare.sources import ComparedSource
from slam_init.compare.trials import Settings, Trial

__all__ = ["Plan"]


@dataclass(frozen=True)
class Plan:
    """What is compared.

    Attributes
    ----------
    sources : tuple of ComparedSource
    methods : tuple of str
    every : int
        A trial starts at every so many frames.
    settings : Settings
        Without its folders, which :func:`compare` chooses.
    """

    sources: tuple[ComparedSource, ...]
    methods: tuple[str, ...]
    every: int = 10
    settings: Settings = field(default_factory=Settings)

    def trials(self) -> Iterator[Trial]:
        """All trials; those of one source follow one another, as it is opened once then."""
        for source in self.sources:
            for start in source.starts(self.every):
                for method in self.methods:
                    yield Trial(source, method, start)

    def holds(self, key: Key) -> bool:
        """Whether a trial belongs to this comparison; a folder may hold those of a wider one."""
        label, method, start = key
        return method in self.methods and start in self._starts.get(label, ())

    @cached_property
    def _starts(self) -> dict[str, range]:
        return {source.label: source.starts(self.every) for source in self.sources}
