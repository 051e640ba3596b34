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


@dataclass(frozen=True)
class Plan:
    """The sources and methods of a comparison; its trials are all combinations of source, start frame and method."""

    sources: tuple[ComparedSource, ...]
    #: Names as in ``slam-init run --method``.
    methods: tuple[str, ...]
    #: Step between two start frames.
    every: int = 10
    #: Smallest number of frames that a trial can read, with the start frame. Two views and a third one that confirms
    #: them are the least from which every method can make a map.
    min_left: int = 3
    #: The folders in it are not used: :func:`slam_init.compare.run.compare` chooses them.
    settings: Settings = field(default_factory=Settings)

    def trials(self) -> Iterator[Trial]:
        """Yield all trials. The trials of one source follow one another, so that a process opens the source once."""
        for source in self.sources:
            for start in self.starts(source):
                for method in self.methods_on(source):
                    yield Trial(source, method, start)

    def batches(self, wanted: Callable[[Key], bool], largest: int) -> Iterator[tuple[Trial, ...]]:
        """Yield trials in batches of one source, so that a worker opens the source once for a batch."""
        trials = (trial for trial in self.trials() if wanted(trial.key))
        for _, of_source in groupby(trials, key=lambda trial: trial.source.label):
            while batch := tuple(islice(of_source, largest)):
                yield batch

    def methods_on(self, source: ComparedSource) -> tuple[str, ...]:
        """Return the methods that can run on a source. External programs need images."""
        if not source.group.startswith(POINTS):
            return self.methods
        return tuple(method for method in self.methods if not is_external(method))

    def not_applicable(self) -> dict[str, int]:
        """Count the sources on which a method cannot run."""
        counts = Counter(m for source in self.sources for m in self.methods if m not in self.methods_on(source))
        return {method: counts[method] for method in self.methods if counts[method]}

    def recordings(self) -> Iterator[str]:
        """Return all files that the trials may write where recordings are asked for."""
        for source in self.sources:
            for start in self.starts(source):
                yield from names_of_start(source.label, start, self.methods_on(source))

    def trajectories(self) -> Iterator[str]:
        """Return all trajectories that the trials may write where they are asked for."""
        for source in self.sources:
            yield from trajectory_names(source.label, self.starts(source), self.methods_on(source))

    def holds(self, key: Key) -> bool:
        """Return whether a trial belongs to this comparison. A results folder can hold the trials of a wider one."""
        label, method, start = key
        return method in self.methods and start in self._starts.get(label, ())

    def starts(self, source: ComparedSource) -> range:
        """Return the start frames of the trials on a source.

        * Returns: Every :attr:`every`-th frame that leaves :attr:`min_left` frames.
        """
        return source.starts(self.every, self.min_left)

    @cached_property
    def _starts(self) -> dict[str, range]:
        return {source.label: self.starts(source) for source in self.sources}

    @cached_property
    def criteria(self) -> dict[str, Criteria]:
        """Return the criteria by which the maps of each source are classified, by the label of the source."""
        return {source.label: source.criteria for source in self.sources}

    def judging(self) -> dict[str, Criteria]:
        """Return the criteria of each group."""
        by_group = {source.group: source.criteria for source in self.sources}
        return dict(sorted(by_group.items()))
