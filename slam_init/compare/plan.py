"""The trials of a comparison: sources, methods, start frames, settings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby, islice

from slam_init.compare.judging import Criteria
from slam_init.compare.recordings import names_of_start
from slam_init.compare.rows import Key
from slam_init.compare.sources import ComparedSource
from slam_init.compare.trajectories import trajectory_names
from slam_init.compare.trials import Settings, Trial
from slam_init.datasets.points import POINTS
from slam_init.methods.external_command import is_external

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
    min_left : int
        Smallest number of frames that a trial can read, with the start frame. Two views and a third one that confirms
        them are the least from which every method can make a map.
    settings : Settings
        The folders in it are not used: :func:`slam_init.compare.run.compare` chooses them.
    """

    sources: tuple[ComparedSource, ...]
    methods: tuple[str, ...]
    every: int = 10
    min_left: int = 3
    settings: Settings = field(default_factory=Settings)

    def trials(self) -> Iterator[Trial]:
        """Yield all trials. The trials of one source follow one another, so that a process opens the source once.

        Yields
        ------
        Trial
            A method on a source from a start frame.
        """
        for source in self.sources:
            for start in self.starts(source):
                for method in self.methods_on(source):
                    yield Trial(source, method, start)

    def batches(self, wanted: Callable[[Key], bool], largest: int) -> Iterator[tuple[Trial, ...]]:
        """Yield trials in batches of one source, so that a worker opens the source once for a batch.

        Parameters
        ----------
        wanted : callable
            Takes the key of a trial and returns whether it is yielded.
        largest : int
            Largest number of trials of a batch.

        Yields
        ------
        tuple of Trial
            Consecutive trials of one source.
        """
        trials = (trial for trial in self.trials() if wanted(trial.key))
        for _, of_source in groupby(trials, key=lambda trial: trial.source.label):
            while batch := tuple(islice(of_source, largest)):
                yield batch

    def methods_on(self, source: ComparedSource) -> tuple[str, ...]:
        """Return the methods that can run on a source. External programs need images.

        Parameters
        ----------
        source : ComparedSource

        Returns
        -------
        tuple of str
        """
        if not source.text.startswith(POINTS):
            return self.methods
        return tuple(method for method in self.methods if not is_external(method))

    def not_applicable(self) -> dict[str, int]:
        """Count the sources on which a method cannot run.

        Returns
        -------
        dict of str to int
            By method; methods that run on all sources are left out.
        """
        counts = Counter(m for source in self.sources for m in self.methods if m not in self.methods_on(source))
        return {method: counts[method] for method in self.methods if counts[method]}

    def recordings(self) -> Iterator[str]:
        """Return all files that the trials may write where recordings are asked for.

        Yields
        ------
        str
            Relative to the folder of the results, with slashes.
        """
        for source in self.sources:
            for start in self.starts(source):
                yield from names_of_start(source.label, start, self.methods_on(source))

    def trajectories(self) -> Iterator[str]:
        """Return all trajectories that the trials may write where they are asked for.

        Yields
        ------
        str
            Relative to the folder of the results, with slashes.
        """
        for source in self.sources:
            yield from trajectory_names(source.label, self.starts(source), self.methods_on(source))

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

    def starts(self, source: ComparedSource) -> range:
        """Return the start frames of the trials on a source.

        Parameters
        ----------
        source : ComparedSource

        Returns
        -------
        range
            Every :attr:`every`-th frame that leaves :attr:`min_left` frames.
        """
        return source.starts(self.every, self.min_left)

    @cached_property
    def _starts(self) -> dict[str, range]:
        return {source.label: self.starts(source) for source in self.sources}

    @cached_property
    def criteria(self) -> dict[str, Criteria]:
        """Return the criteria by which the maps of each source are classified, by the label of the source.

        Returns
        -------
        dict of str to Criteria
        """
        return {source.label: source.criteria for source in self.sources}

    def judging(self) -> dict[str, Criteria]:
        """Return the criteria of each group.

        Returns
        -------
        dict of str to Criteria
            By :attr:`ComparedSource.group`, sorted.
        """
        by_group = {source.group: source.criteria for source in self.sources}
        return dict(sorted(by_group.items()))
