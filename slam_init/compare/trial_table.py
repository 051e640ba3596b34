"""The trials of a comparison as a table of columns, and the parts of trials that are counted together."""

from __future__ import annotations

import math
from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from sys import intern
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_init.compare.judging import NOT_JUDGED, Truth, criteria_of
from slam_init.compare.rows import TrialRow
from slam_init.compare.sources import focal_error_of
from slam_init.datasets.points import POINTS
from slam_init.types.arrays import Bools, Ints

_TEXTS = ("source", "method", "group", "outcome", "reason", "keyframes")
#: Numeric columns that are kept in memory, with eight bytes per trial and column.
_NUMBERS = (
    "start", "frames_to_accept", "frames_limit", "seconds_to_accept", "rotation_error_deg", "direction_error_deg",
    "ate", "rotation_error_before_deg", "direction_error_before_deg", "ate_before", "survival", "depth_error",
    "depth_order_error", "landmarks", "frame_median_ms", "frame_p95_ms", "attempt_median_ms", "trial_ms",
    "peak_memory_mb", "suspected_focal_factor", "reported_focal_factor", "reported_distortion", "risk",
    "rotation_sigma_deg", "direction_sigma_deg", "pair_rotation_error_deg", "pair_direction_error_deg", "audited_risk",
)  # fmt: skip
#: Columns that are true or false.
_FLAGS: dict[str, Callable[[TrialRow], bool]] = {
    # The map is correct and strict.
    "strict": lambda row: bool(row.strict),
    # The scene has an expected reason; the trial ended with this reason.
    "reason_expected": lambda row: row.reason_right is not None,
    "reason_right": lambda row: bool(row.reason_right),
    # The trial ended with ``ambiguous_plane`` and there is a ground truth; one of its stored hypotheses is correct.
    "ambiguous": lambda row: row.kept_truth is not None,
    "kept_truth": lambda row: bool(row.kept_truth),
    # The stated focal length is wrong on purpose.
    "wrong_focal": lambda row: focal_error_of(row.source) != 0,
    # A map can be correct: the source has a ground truth, and the camera translates.
    "solvable": lambda row: (
        row.judged_by != NOT_JUDGED.rule and row.outcome != "accepted" and not criteria_of(row.group).no_translation
    ),
    # The ground truth is sound (:mod:`slam_init.compare.judging`).
    "sound": lambda row: row.judged_by != NOT_JUDGED.rule and criteria_of(row.group).truth is Truth.SOUND,
}
#: Trials that are counted together, and the heading of each part. Images and tracks without images (points) are counted
#: separately. So are the trials in which the camera does not translate (static or rotation-only), because no map can be
#: correct there.
PARTS = {
    "image_moving": "images, moving camera",
    "image_static": "images, no translation",
    "points_moving": "points, moving camera",
    "points_static": "points, no translation",
}
#: The two levels of trials: parts whose names begin with the name of a level belong to it.
LEVELS = {"image": "images", "points": "points"}


def _level_of(group: str) -> str:
    return "points" if group.startswith(POINTS) else "image"


def _part_of(group: str) -> str:
    return f"{_level_of(group)}_{'static' if criteria_of(group).no_translation else 'moving'}"


class TrialTable:
    """The trials, stored by column: ``table["outcome"]`` (N,).

    A text without a value is empty, and a number without one is NaN.
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self._columns = columns

    @staticmethod
    def read(rows: Iterable[TrialRow]) -> TrialTable:
        """Read rows, one at a time."""
        text: dict[str, list[str]] = {name: [] for name in _TEXTS}
        # Of a trial an array takes 8 bytes for each number and 1 for each flag; lists took 32 and 8.
        numbers = {name: array("d") for name in _NUMBERS}
        flags = {name: bytearray() for name in _FLAGS}
        for row in rows:
            for name in _TEXTS:
                text[name].append(intern(getattr(row, name) or ""))
            for name in _NUMBERS:
                value = getattr(row, name)
                numbers[name].append(math.nan if value is None else float(value))
            for name, is_set in _FLAGS.items():
                flags[name].append(is_set(row))
        columns: dict[str, NDArray[Any]] = {name: np.array(values, object) for name, values in text.items()}
        columns |= {name: np.array(values, float) for name, values in numbers.items()}
        return TrialTable(columns | {name: np.frombuffer(values, bool) for name, values in flags.items()})

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._columns[name]

    def __len__(self) -> int:
        return len(self["source"])

    def select(self, rows: Ints | Bools) -> TrialTable:
        """Return some trials as a table: ``rows`` (K,) or a mask (N,)."""
        return TrialTable({name: values[rows] for name, values in self._columns.items()})

    def of_method(self, method: str) -> TrialTable:
        """Return the trials of a method."""
        return self.select(self["method"] == method)

    def with_direction(self) -> TrialTable:
        """Return the trials whose direction is judged."""
        judged = {group for group in set(self["group"]) if criteria_of(group).direction_deg is not None}
        return self.select(np.isin(self["group"].astype(str), sorted(judged)))

    def by_trial(self, values: NDArray[Any]) -> dict[tuple[str, int], Any]:
        """Return values of the trials by source and start frame: ``values`` (N,)."""
        keys = zip(self["source"].tolist(), self["start"].astype(int).tolist(), strict=True)
        return dict(zip(keys, values.tolist(), strict=True))

    def cells(self) -> dict[tuple[str, str], Ints]:
        """Find the trials of each group and method in one pass: a comparison may have a thousand scenes.

        * Returns: Rows of the trials by group and method; a pair without trials has none.
        """
        found: defaultdict[tuple[str, str], list[int]] = defaultdict(list)
        for row, cell in enumerate(zip(self["group"].tolist(), self["method"].tolist(), strict=True)):
            found[cell].append(row)
        nothing = np.zeros(0, np.int64)
        return defaultdict(lambda: nothing, {cell: np.array(rows, np.int64) for cell, rows in found.items()})

    def parts(self) -> dict[str, TrialTable]:
        """Return the trials of each part; a part without trials is left out."""
        return self._split(_part_of, PARTS)

    def levels(self) -> dict[str, TrialTable]:
        """Return the trials of each level; a level without trials is left out."""
        return self._split(_level_of, LEVELS)

    def _split(self, name_of: Callable[[str], str], order: Iterable[str]) -> dict[str, TrialTable]:
        names = {group: name_of(group) for group in set(self["group"])}
        of_trial = np.array([names[group] for group in self["group"]], object)
        return {name: self.select(of_trial == name) for name in order if np.any(of_trial == name)}
