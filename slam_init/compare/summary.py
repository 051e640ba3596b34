"""The summary of a comparison: the content of ``summary.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slam_init.compare.figures import Figures, PairTest, WaitDifference, figures_of, pair_tests, wait_differences
from slam_init.compare.judging import Criteria
from slam_init.compare.reliability import Reliability, reliabilities
from slam_init.compare.trial_table import TrialTable
from slam_init.output.plain_json import Json, plain_fields

if TYPE_CHECKING:
    from slam_init.compare.plan import Plan

#: Version 2 added the figures of ambiguous planes and of suspected focal lengths. Version 3 renamed the parts
#: ``image_still`` and ``points_still`` to ``image_static`` and ``points_static``. Version 4 added ``min_left``,
#: ``judging``, ``wait``, ``waits`` and ``reliability``. Version 5 added the figures of the audit.
_SCHEMA = 5


@dataclass(frozen=True)
class ComparisonSummary:
    """All figures of a comparison. Only the times and the peak memory differ from run to run."""

    #: Version of the layout of ``summary.json``.
    schema: int
    #: Seed of the random draws of the methods.
    seed: int
    #: Step between two start frames.
    every: int
    #: Smallest number of frames that a trial could read, with the start frame.
    min_left: int
    #: Largest number of frames that a trial could read.
    limit_frames: int
    #: Largest number of seconds of video that a trial on a video could read.
    limit_s: float
    #: Number of trials.
    trials: int
    #: Names of the methods.
    methods: tuple[str, ...]
    #: Labels of the sources.
    sources: tuple[str, ...]
    #: How each group is judged.
    judging: Mapping[str, Criteria]
    #: Figures by part (:data:`slam_init.compare.trial_table.PARTS`) and method. A part without trials is left out.
    parts: Mapping[str, Mapping[str, Figures]]
    #: Figures by scene and method.
    groups: Mapping[str, Mapping[str, Figures]]
    #: Comparisons of two methods on the same trials, by part.
    pairs: Mapping[str, tuple[PairTest, ...]]
    #: Comparisons of the wait of the first method with that of each other one, by part with a moving camera.
    waits: Mapping[str, tuple[WaitDifference, ...]]
    #: Reliability of the stated risk, by level (images, points) and by method that states one. A level without such a
    #: method is left out.
    reliability: Mapping[str, Mapping[str, Reliability]]

    def as_dict(self) -> dict[str, Json]:
        """Convert to plain JSON types, as in the file.

        * Returns: An :class:`~slam_init.compare.statistics.Interval` becomes a list of value, low and high end. Figures
          have six significant digits, and a figure that is not finite is None.
        """
        return plain_fields(self)


def summary_of(table: TrialTable, plan: Plan) -> ComparisonSummary:
    """Compute all figures of a comparison."""
    parts, cells = table.parts(), table.cells()
    return ComparisonSummary(
        schema=_SCHEMA,
        seed=plan.settings.seed,
        every=plan.every,
        min_left=plan.min_left,
        limit_frames=plan.settings.limit_frames,
        limit_s=plan.settings.limit_s,
        trials=len(table),
        methods=tuple(plan.methods),
        sources=tuple(source.label for source in plan.sources),
        judging=plan.judging(),
        parts={
            name: {method: figures_of(part.of_method(method)) for method in plan.methods}
            for name, part in parts.items()
        },
        # The figures of a scene are computed from its trials alone: there may be a thousand scenes.
        groups={
            group: {method: figures_of(table.select(cells[group, method])) for method in plan.methods}
            for group in sorted(set(table["group"].tolist()))
        },
        pairs={name: tuple(pair_tests(part, plan.methods)) for name, part in parts.items()},
        waits={
            name: tuple(wait_differences(part, plan.methods)) for name, part in parts.items() if name.endswith("moving")
        },
        reliability=reliabilities(table, plan.methods),
    )
