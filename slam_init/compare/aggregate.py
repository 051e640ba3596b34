"""From rows to figures: counts with intervals, times, errors, and tests on the same trials."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from sys import intern
from typing import Any

import numpy as np

from slam_init.compare.sources import focal_error_of, judging_of
from slam_init.compare.statistics import Interval, holm, mcnemar_exact, restricted_mean, wilson
from slam_init.datasets.points import POINTS
from slam_init.types.arrays import Bools, Floats

__all__ = ["NUMBERS", "PARTS", "Figures", "PairTest", "TrialTable", "figures_of", "pair_tests", "summary_of"]

#: Numeric columns that are kept in memory, eight bytes a trial each.
NUMBERS = (
    "start", "frames_to_accept", "frames_limit", "seconds_to_accept", "rotation_error_deg", "direction_error_deg",
    "ate", "rotation_error_before_deg", "direction_error_before_deg", "ate_before", "survival", "depth_error",
    "depth_order_error", "landmarks", "frame_median_ms", "frame_p95_ms", "attempt_median_ms", "trial_ms",
    "peak_memory_mb", "suspected_focal_factor", "reported_focal_factor",
)  # fmt: skip
#: Figures whose medians over the accepted maps are told, and those of the correct maps among them.
_MEDIANS_OF_CORRECT = (
    "rotation_error_deg", "direction_error_deg", "ate", "rotation_error_before_deg", "direction_error_before_deg",
    "ate_before", "survival", "depth_error", "depth_order_error", "landmarks",
)  # fmt: skip
_TIMES = ("frame_median_ms", "frame_p95_ms", "attempt_median_ms", "trial_ms")


#: Trials that may be counted together. Tracks without images are no substitute for images, nor the other way round; and
#: where the camera stays, no map can be correct.
PARTS = {
    "image_moving": "images, moving camera",
    "image_still": "images, no translation",
    "points_moving": "points, moving camera",
    "points_still": "points, no translation",
}


def _part_of(group: str) -> str:
    level = "points" if group.startswith(POINTS) else "image"
    return f"{level}_{'still' if judging_of(group).still else 'moving'}"


@dataclass(frozen=True, eq=False)
class TrialTable:
    """The trials column by column.

    Attributes
    ----------
    text : dict of (N,) object arrays
        ``source``, ``method``, ``group``, ``outcome``, ``reason``, ``keyframes``; empty text where there is none.
    numbers : dict of (N,) float arrays
        :data:`NUMBERS`, NaN where there is none.
    strict, judged_reason, right_reason : (N,) bool
        Whether a correct map is also strict; whether a cause was injected, and whether the reason named it.
    judged_kept, kept_truth : (N,) bool
        Whether the trial ended with an undecided plane and a truth to judge by, and whether a kept map is correct.
    wrong_focal : (N,) bool
        Whether the stated focal length is wrong on purpose.
    """

    text: dict[str, Any]
    numbers: dict[str, Floats]
    strict: Bools
    judged_reason: Bools
    right_reason: Bools
    judged_kept: Bools
    kept_truth: Bools
    wrong_focal: Bools

    @staticmethod
    def of(rows: Iterable[Mapping[str, Any]]) -> TrialTable:
        """Read rows, one at a time."""
        names = ("source", "method", "group", "outcome", "reason", "keyframes")
        text: dict[str, list[str]] = {name: [] for name in names}
        numbers: dict[str, list[float]] = {name: [] for name in NUMBERS}
        flags: dict[str, list[bool]] = {
            name: [] for name in ("strict", "judged", "right", "undecided", "kept", "focal")
        }
        for row in rows:
            for name in names:
                text[name].append(intern(row[name] or ""))
            for name in NUMBERS:
                numbers[name].append(math.nan if row.get(name) is None else float(row[name]))
            flags["strict"].append(bool(row["strict"]))
            flags["judged"].append(row["reason_right"] is not None)
            flags["right"].append(bool(row["reason_right"]))
            flags["undecided"].append(row["kept_truth"] is not None)
            flags["kept"].append(bool(row["kept_truth"]))
            flags["focal"].append(focal_error_of(row["source"]) != 0)
        return TrialTable(
            text={name: np.array(values, object) for name, values in text.items()},
            numbers={name: np.array(values, float) for name, values in numbers.items()},
            strict=np.array(flags["strict"], bool),
            judged_reason=np.array(flags["judged"], bool),
            right_reason=np.array(flags["right"], bool),
            judged_kept=np.array(flags["undecided"], bool),
            kept_truth=np.array(flags["kept"], bool),
            wrong_focal=np.array(flags["focal"], bool),
        )

    def __len__(self) -> int:
        return len(self.strict)

    def where(self, **wanted: str) -> Bools:
        """Mask (N,) of the trials with these texts."""
        mask = np.ones(len(self), bool)
        for name, value in wanted.items():
            mask &= self.text[name] == value
        return mask

    def knows_direction(self) -> Bools:
        """Mask (N,) of the trials whose truth knows the direction of a short baseline."""
        known = {group: judging_of(group).direction_known for group in set(self.text["group"])}
        return np.array([known[group] for group in self.text["group"]], bool)

    def parts(self) -> dict[str, Bools]:
        """Masks (N,) of :data:`PARTS` that have trials."""
        names = {group: _part_of(group) for group in set(self.text["group"])}
        part = np.array([names[group] for group in self.text["group"]], object)
        return {name: part == name for name in PARTS if np.any(part == name)}


@dataclass(frozen=True)
class Figures:
    """What a set of trials says.

    ``frames_to_accept`` and ``frames_to_correct`` are restricted means: a trial without counts as its limit.
    ``medians`` are those of the correct maps, None where there are none. ``times`` are medians over trials, but the
    95th percentile of the frames is that of the worst trial but 5 %. ``kept_truth_rate`` is the share of the undecided
    planes (``undecided``) whose kept maps hold the truth; ``suspicion_rate`` that of the runs with a wrong focal length
    in which a check suspects it, ``report_rate`` that of those which tell the user; ``false_report_rate`` that of the
    runs with a right one which do.
    """

    trials: int
    correct: int
    strict: int
    false: int
    none: int
    error: int
    accepted: int
    correct_rate: Interval
    false_rate: Interval
    precision: Interval
    frames_to_accept: Interval
    frames_to_correct: Interval
    seconds_to_accept: Interval
    reason_accuracy: Interval
    undecided: int
    kept_truth_rate: Interval
    suspicion_rate: Interval
    report_rate: Interval
    false_report_rate: Interval
    reasons: dict[str, int]
    medians: dict[str, float | None]
    times: dict[str, float | None]
    peak_memory_mb: float | None


def figures_of(table: TrialTable, mask: Bools) -> Figures:
    """The figures of the trials in a mask."""
    outcome = table.text["outcome"][mask]
    counts = Counter(outcome.tolist())
    trials, correct, false = int(mask.sum()), counts["correct"], counts["false"]
    accepted = correct + false + counts["accepted"]
    numbers = {name: values[mask] for name, values in table.numbers.items()}
    is_correct = outcome == "correct"
    frames, limits = numbers["frames_to_accept"], numbers["frames_limit"]
    judged, undecided = table.judged_reason[mask], int(table.judged_kept[mask].sum())
    wrong_focal = table.wrong_focal[mask]
    suspects, reports = (np.isfinite(numbers[f"{name}_focal_factor"]) for name in ("suspected", "reported"))
    reasons = Counter(table.text["reason"][mask][(outcome == "none") | (outcome == "error")].tolist())
    timed = {name: _median(numbers[name]) for name in _TIMES if name != "frame_p95_ms"}
    peaks = numbers["peak_memory_mb"][np.isfinite(numbers["peak_memory_mb"])]
    return Figures(
        trials=trials,
        correct=correct,
        strict=int(np.sum(is_correct & table.strict[mask])),
        false=false,
        none=counts["none"],
        error=counts["error"],
        accepted=accepted,
        correct_rate=wilson(correct, trials),
        false_rate=wilson(false, trials),
        precision=wilson(correct, correct + false),
        frames_to_accept=restricted_mean(frames, limits),
        frames_to_correct=restricted_mean(np.where(is_correct, frames, np.nan), limits),
        seconds_to_accept=_mean_seconds(numbers["seconds_to_accept"]),
        reason_accuracy=wilson(int(np.sum(table.right_reason[mask])), int(judged.sum())),
        undecided=undecided,
        kept_truth_rate=wilson(int(np.sum(table.kept_truth[mask])), undecided),
        suspicion_rate=wilson(int(np.sum(suspects & wrong_focal)), int(wrong_focal.sum())),
        report_rate=wilson(int(np.sum(reports & wrong_focal)), int(wrong_focal.sum())),
        false_report_rate=wilson(int(np.sum(reports & ~wrong_focal)), int(np.sum(~wrong_focal))),
        reasons=dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0]))),
        medians={name: _median(numbers[name][is_correct]) for name in _MEDIANS_OF_CORRECT},
        times=timed | {"frame_p95_ms": _quantile(numbers["frame_p95_ms"], 0.95)},
        peak_memory_mb=float(peaks.max()) if len(peaks) else None,
    )


@dataclass(frozen=True)
class PairTest:
    """Two methods on the same trials: who alone was correct how often, who alone was false, and p-values of McNemar.

    ``p_holm`` is adjusted for the number of pairs that were compared.
    """

    first: str
    second: str
    trials: int
    only_first_correct: int
    only_second_correct: int
    p_correct: float
    p_correct_holm: float
    only_first_false: int
    only_second_false: int
    p_false: float
    p_false_holm: float


def pair_tests(table: TrialTable, methods: Sequence[str], mask: Bools) -> list[PairTest]:
    """Every pair of methods on the trials in a mask that both ran."""
    outcomes = {
        method: _by_trial(table, mask & table.where(method=method)) for method in methods
    }  # source and start -> outcome
    found = []
    for first, second in combinations(methods, 2):
        shared = outcomes[first].keys() & outcomes[second].keys()
        counts = Counter((outcomes[first][key], outcomes[second][key]) for key in shared)

        def only(outcome: str, counts: Counter[tuple[str, str]] = counts) -> tuple[int, int]:
            one = sum(n for (a, b), n in counts.items() if a == outcome and b != outcome)
            return one, sum(n for (a, b), n in counts.items() if b == outcome and a != outcome)

        found.append((first, second, len(shared), only("correct"), only("false")))
    correct = [mcnemar_exact(*pair[3]) for pair in found]
    false = [mcnemar_exact(*pair[4]) for pair in found]
    adjusted = zip(found, correct, holm(correct), false, holm(false), strict=True)
    return [
        PairTest(first, second, trials, *right, p_right, p_right_holm, *wrong, p_wrong, p_wrong_holm)
        for (first, second, trials, right, wrong), p_right, p_right_holm, p_wrong, p_wrong_holm in adjusted
    ]


def summary_of(table: TrialTable, methods: Sequence[str]) -> dict[str, Any]:
    """The figures as plain JSON types; what differs from run to run has names that end in ``_ms`` or ``_mb``."""
    parts = table.parts()
    groups = sorted(set(table.text["group"].tolist()))
    return {
        "parts": {
            name: {m: _plain_figures(figures_of(table, table.where(method=m) & mask)) for m in methods}
            for name, mask in parts.items()
        },
        "groups": {
            group: {m: _plain_figures(figures_of(table, table.where(method=m, group=group))) for m in methods}
            for group in groups
        },
        "pairs": {
            name: [_plain(vars(test)) for test in pair_tests(table, methods, mask)] for name, mask in parts.items()
        },
    }


def _by_trial(table: TrialTable, mask: Bools) -> dict[tuple[str, int], str]:
    sources, starts = table.text["source"][mask].tolist(), table.numbers["start"][mask].astype(int).tolist()
    return dict(zip(zip(sources, starts, strict=True), table.text["outcome"][mask].tolist(), strict=True))


def _plain_figures(figures: Figures) -> dict[str, Any]:
    values = vars(figures) | {"times": None}
    del values["times"]
    return {**_plain(values), **_plain(figures.times)}


def _plain(value: Any) -> Any:
    if isinstance(value, Interval):
        return [_plain(value.value), _plain(value.low), _plain(value.high)]
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


def _median(values: Floats) -> float | None:
    return _quantile(values, 0.5)


def _quantile(values: Floats, q: float) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.quantile(known, q)) if len(known) else None


def _mean_seconds(values: Floats) -> Interval:
    """Mean over the accepted maps."""
    known = values[np.isfinite(values)]
    return restricted_mean(known, np.full(len(known), np.inf))
