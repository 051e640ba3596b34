"""The trials of a comparison as a table of columns, and the parts of trials that are counted together."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from sys import intern
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_init.compare.judging import NOT_JUDGED, Truth, criteria_of
from slam_init.compare.rows import TrialRow
from slam_init.compare.sources import focal_error_of
from slam_init.datasets.points import POINTS
from slam_init.types.arrays import Bools, Floats, Ints

_TEXTS = ("source", "method", "group", "outcome", "reason", "keyframes")
#: Numeric columns that are kept in memory, with eight bytes per trial and column.
_NUMBERS = (
    "start", "frames_to_accept", "frames_limit", "seconds_to_accept", "rotation_error_deg", "direction_error_deg",
    "ate", "rotation_error_before_deg", "direction_error_before_deg", "ate_before", "survival", "depth_error",
    "depth_order_error", "landmarks", "frame_median_ms", "frame_p95_ms", "attempt_median_ms", "trial_ms",
    "peak_memory_mb", "suspected_focal_factor", "reported_focal_factor", "reported_distortion", "risk",
    "rotation_sigma_deg", "direction_sigma_deg", "pair_rotation_error_deg", "pair_direction_error_deg",
)  # fmt: skip
#: Columns that are true or false; see the fields of :class:`TrialTable`.
_FLAGS: dict[str, Callable[[TrialRow], bool]] = {
    "strict": lambda row: bool(row.strict),
    "reason_expected": lambda row: row.reason_right is not None,
    "reason_right": lambda row: bool(row.reason_right),
    "ambiguous": lambda row: row.kept_truth is not None,
    "kept_truth": lambda row: bool(row.kept_truth),
    "wrong_focal": lambda row: focal_error_of(row.source) != 0,
    "solvable": lambda row: (
        row.judged_by != NOT_JUDGED.rule and row.outcome != "accepted" and not criteria_of(row.group).no_translation
    ),
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


@dataclass(frozen=True, eq=False)
class TrialTable:
    """The trials, stored by column; each column (N,)."""

    #: ``source``, ``method``, ``group``, ``outcome``, ``reason``, ``keyframes``; an empty text if there is no value.
    text: dict[str, NDArray[np.object_]]
    #: The numbers of a :class:`~slam_init.compare.rows.TrialRow`; NaN if there is no value.
    numbers: dict[str, Floats]
    #: The map is correct and strict.
    strict: Bools
    #: reason_expected, reason_right: The scene has an expected reason; the trial ended with this reason.
    reason_expected: Bools
    reason_right: Bools
    #: ambiguous, kept_truth: The trial ended with ``ambiguous_plane`` and there is a ground truth; one of its stored
    #: hypotheses is correct.
    ambiguous: Bools
    kept_truth: Bools
    #: The stated focal length is wrong on purpose.
    wrong_focal: Bools
    #: A map can be correct: the source has a ground truth, and the camera translates.
    solvable: Bools
    #: The ground truth is sound (:mod:`slam_init.compare.judging`).
    sound: Bools

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
        return TrialTable(
            text={name: np.array(values, object) for name, values in text.items()},
            numbers={name: np.array(values, float) for name, values in numbers.items()},
            **{name: np.frombuffer(values, bool) for name, values in flags.items()},
        )

    def __len__(self) -> int:
        return len(self.strict)

    def where(self, **wanted: str) -> Bools:
        """Select the trials in which all of these text columns have the given values."""
        mask = np.ones(len(self), bool)
        for name, value in wanted.items():
            mask &= self.text[name] == value
        return mask

    def select(self, rows: Ints) -> TrialTable:
        """Return some trials as a table: ``rows`` (K,)."""
        return TrialTable(
            text={name: values[rows] for name, values in self.text.items()},
            numbers={name: values[rows] for name, values in self.numbers.items()},
            **{name: getattr(self, name)[rows] for name in _FLAGS},
        )

    def by_trial(self, values: NDArray[Any], mask: Bools) -> dict[tuple[str, int], Any]:
        """Return the values of the selected trials by source and start frame."""
        sources, starts = self.text["source"][mask].tolist(), self.numbers["start"][mask].astype(int).tolist()
        return dict(zip(zip(sources, starts, strict=True), values[mask].tolist(), strict=True))

    def cells(self) -> dict[tuple[str, str], Ints]:
        """Find the trials of each group and method in one pass: a comparison may have a thousand scenes.

        * Returns: Rows of the trials by group and method; a pair without trials is left out.
        """
        found: dict[tuple[str, str], list[int]] = {}
        for row, cell in enumerate(zip(self.text["group"].tolist(), self.text["method"].tolist(), strict=True)):
            found.setdefault(cell, []).append(row)
        return {cell: np.array(rows, np.int64) for cell, rows in found.items()}

    def knows_direction(self) -> Bools:
        """Select the trials whose direction is judged."""
        return self._by_group(lambda group: criteria_of(group).direction_deg is not None).astype(bool)

    def parts(self) -> dict[str, Bools]:
        """Select the trials of each part."""
        return self._by_name(_part_of, PARTS)

    def levels(self) -> dict[str, Bools]:
        """Select the trials of each level."""
        return self._by_name(_level_of, LEVELS)

    def _by_name(self, name_of: Callable[[str], str], order: Mapping[str, str]) -> dict[str, Bools]:
        """Return the mask of the trials of each name; a name without trials is left out."""
        of_trial = self._by_group(name_of)
        return {name: of_trial == name for name in order if np.any(of_trial == name)}

    def _by_group(self, value_of: Callable[[str], object]) -> NDArray[np.object_]:
        values = {group: value_of(group) for group in set(self.text["group"])}
        return np.array([values[group] for group in self.text["group"]], object)
