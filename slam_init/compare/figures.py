"""The wait: the number of frames after the start frame until the first correct map.

A wait of 1 is the least possible: a correct map at the second frame. A trial without a correct map counts as its limit,
which is the number of frames after the start frame that the trial can read. The mean of these values is the restricted
mean of the wait. Trials of sequences without ground truth, and of cameras that do not translate, have no wait.

Trials of one sequence overlap and are not independent. The intervals are therefore those of a bootstrap over sequences.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from slam_init.compare.statistics import Interval, cluster_mean, holm, mcnemar_exact, restricted_mean, wilson
from slam_init.compare.trial_table import TrialTable
from slam_init.decision.audit import WRONG
from slam_init.types.arrays import Floats, Ints


@dataclass(frozen=True)
class WaitDifference:
    """The waits of two methods on the same trials."""

    #: first, second: The methods.
    first: str
    second: str
    #: Number of trials that both methods ran and that have a wait.
    trials: int
    #: Number of sequences of these trials.
    sequences: int
    #: Mean of the wait of the first method minus that of the second one, in frames. The interval is that of a
    #: bootstrap over sequences; its ends are NaN for a single sequence.
    difference_frames: Interval


def waits(table: TrialTable) -> Floats:
    """Return the wait (N,) of each trial in frames; NaN for a trial in which no map can be correct."""
    limits = table["frames_limit"] - 1
    frames = np.where(table["outcome"] == "correct", table["frames_to_accept"] - 1, limits)
    return np.where(table["solvable"], np.minimum(frames, limits), np.nan)


def mean_wait(table: TrialTable) -> Interval:
    """Compute the restricted mean of the wait of the trials in frames."""
    table = table.select(table["solvable"])
    return cluster_mean(waits(table), table["source"])


def wait_differences(table: TrialTable, methods: Sequence[str]) -> list[WaitDifference]:
    """Compare the wait of the first method with that of each other method, trial by trial."""
    table = table.select(table["solvable"])
    parts = {method: table.of_method(method) for method in methods}
    by_method = {method: part.by_trial(waits(part)) for method, part in parts.items()}
    first = by_method[methods[0]]
    differences = []
    for other in methods[1:]:
        shared = sorted(first.keys() & by_method[other].keys())
        sources = np.array([source for source, _ in shared], object)
        frames = np.array([first[key] - by_method[other][key] for key in shared], float)
        mean = cluster_mean(frames, sources)
        differences.append(WaitDifference(methods[0], other, len(shared), len(set(sources)), mean))
    return differences


#: Columns whose medians over the correct maps are reported.
_MEDIANS_OF_CORRECT = (
    "rotation_error_deg", "direction_error_deg", "ate", "rotation_error_before_deg", "direction_error_before_deg",
    "ate_before", "survival", "depth_error", "depth_order_error", "landmarks",
)  # fmt: skip


@dataclass(frozen=True)
class Figures:
    """Figures of a set of trials."""

    #: trials, correct, strict, false, none, error, accepted: Number of trials, and number of trials with each
    #: outcome. ``accepted`` counts all maps.
    trials: int
    correct: int
    strict: int
    false: int
    none: int
    error: int
    accepted: int
    #: correct_rate, false_rate: Share of the trials with a correct map, and of the judged ones with a false map.
    correct_rate: Interval
    false_rate: Interval
    #: Correct maps as a share of the correct and false maps.
    precision: Interval
    #: frames_to_accept, frames_to_correct: Restricted mean of the frames until the first map, and until a correct
    #: map. A trial without such a map counts as its limit.
    frames_to_accept: Interval
    frames_to_correct: Interval
    #: Restricted mean of the frames after the start frame until the first correct map; see
    #: :mod:`slam_init.compare.figures`.
    wait: Interval
    #: Mean over the accepted maps.
    seconds_to_accept: Interval
    #: Of the trials with an expected reason, the share that ended with this reason.
    reason_accuracy: Interval
    #: Number of trials that ended with ``ambiguous_plane``.
    undecided: int
    #: Of these trials, the share in which one of the stored hypotheses is correct.
    kept_truth_rate: Interval
    #: suspicion_rate, report_rate: Of the trials with a wrong stated focal length, the share in which an attempt
    #: suspects it, and the share in which the result reports it.
    suspicion_rate: Interval
    report_rate: Interval
    #: Of the trials with the true focal length, the share in which the result reports that it is wrong.
    false_report_rate: Interval
    #: Mean over the maps of the probability that they are wrong, by the audit; None without one. With reliable risks
    #: it is the share of the false ones.
    audited_risk: float | None
    #: Share of these maps that the audit calls wrong.
    audited_wrong_rate: Interval
    #: Number of trials without a map, by their reason or error message.
    reasons: dict[str, int]
    #: Medians over the correct maps; None if there are no correct maps.
    medians: dict[str, float | None]
    #: Largest peak over the trials.
    peak_memory_mb: float | None
    #: frame_median_ms, attempt_median_ms, trial_ms: Medians over the trials.
    frame_median_ms: float | None
    attempt_median_ms: float | None
    trial_ms: float | None
    #: 95th percentile over the trials of the 95th percentile over the frames of a trial.
    frame_p95_ms: float | None


def figures_of(table: TrialTable) -> Figures:
    """Compute the figures of a set of trials."""
    outcome = table["outcome"]
    counts = Counter(outcome.tolist())
    trials, correct, false = len(table), counts["correct"], counts["false"]
    is_correct, wrong_focal = outcome == "correct", table["wrong_focal"]
    frames, limits = table["frames_to_accept"], table["frames_limit"]
    undecided = int(table["ambiguous"].sum())
    suspects, reports = (np.isfinite(table[f"{name}_focal_factor"]) for name in ("suspected", "reported"))
    reasons = Counter(table["reason"][(outcome == "none") | (outcome == "error")].tolist())
    audited = table["audited_risk"][np.isfinite(table["audited_risk"])]
    seconds = table["seconds_to_accept"][np.isfinite(table["seconds_to_accept"])]
    return Figures(
        trials=trials,
        correct=correct,
        strict=int(np.sum(is_correct & table["strict"])),
        false=false,
        none=counts["none"],
        error=counts["error"],
        accepted=correct + false + counts["accepted"],
        correct_rate=wilson(correct, trials),
        false_rate=wilson(false, trials - counts["accepted"]),
        precision=wilson(correct, correct + false),
        frames_to_accept=restricted_mean(frames, limits),
        frames_to_correct=restricted_mean(np.where(is_correct, frames, np.nan), limits),
        wait=mean_wait(table),
        seconds_to_accept=restricted_mean(seconds, np.full(len(seconds), np.inf)),
        reason_accuracy=wilson(int(np.sum(table["reason_right"])), int(table["reason_expected"].sum())),
        undecided=undecided,
        kept_truth_rate=wilson(int(np.sum(table["kept_truth"])), undecided),
        suspicion_rate=wilson(int(np.sum(suspects & wrong_focal)), int(wrong_focal.sum())),
        report_rate=wilson(int(np.sum(reports & wrong_focal)), int(wrong_focal.sum())),
        false_report_rate=wilson(int(np.sum(reports & ~wrong_focal)), int(np.sum(~wrong_focal))),
        audited_risk=float(audited.mean()) if len(audited) else None,
        audited_wrong_rate=wilson(int(np.sum(audited > WRONG)), len(audited)),
        reasons=dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0]))),
        medians={name: _median(table[name][is_correct]) for name in _MEDIANS_OF_CORRECT},
        peak_memory_mb=_quantile(table["peak_memory_mb"], 1.0),
        frame_median_ms=_median(table["frame_median_ms"]),
        attempt_median_ms=_median(table["attempt_median_ms"]),
        trial_ms=_median(table["trial_ms"]),
        frame_p95_ms=_quantile(table["frame_p95_ms"], 0.95),
    )


@dataclass(frozen=True, eq=False)
class Paired:
    """The outcomes of two methods on the N trials that both ran."""

    #: first, second: The methods.
    first: str
    second: str
    #: (N,) Source of each trial.
    sources: NDArray[np.object_]
    #: correct, false: (N,) 1 where only the first method has a correct (false) map, -1 where only the second one has.
    correct: Ints
    false: Ints


def paired_outcomes(table: TrialTable, methods: Sequence[str]) -> list[Paired]:
    """Compare the outcomes of every pair of methods, trial by trial."""
    parts = {method: table.of_method(method) for method in methods}
    outcomes = {method: part.by_trial(part["outcome"]) for method, part in parts.items()}
    pairs = []
    for first, second in combinations(methods, 2):
        shared = sorted(outcomes[first].keys() & outcomes[second].keys())
        one, other = (np.array([outcomes[method][key] for key in shared], object) for method in (first, second))
        correct, false = ((one == kind).astype(int) - (other == kind) for kind in ("correct", "false"))
        pairs.append(Paired(first, second, np.array([source for source, _ in shared], object), correct, false))
    return pairs


def only_counts(difference: Ints) -> tuple[int, int]:
    """Number of trials in which only the first method has an outcome, and in which only the second one has it."""
    return int(np.sum(difference > 0)), int(np.sum(difference < 0))


@dataclass(frozen=True)
class PairTest:
    """Comparison of two methods on the same trials, with p-values of McNemar's exact test."""

    #: first, second: The methods.
    first: str
    second: str
    #: Number of trials that both methods ran.
    trials: int
    #: only_first_correct, only_second_correct: Number of trials in which only this method found a correct map.
    only_first_correct: int
    only_second_correct: int
    #: p_correct, p_correct_holm: p-value that both methods are correct equally often; the second one is adjusted for
    #: the number of pairs.
    p_correct: float
    p_correct_holm: float
    #: only_first_false, only_second_false: Number of trials in which only this method accepted a false map.
    only_first_false: int
    only_second_false: int
    #: p_false, p_false_holm: p-value that both methods are false equally often; the second one is adjusted for the
    #: number of pairs.
    p_false: float
    p_false_holm: float


def pair_tests(table: TrialTable, methods: Sequence[str]) -> list[PairTest]:
    """Test every pair of methods on the trials that both ran."""
    pairs = paired_outcomes(table, methods)
    correct = [mcnemar_exact(*only_counts(pair.correct)) for pair in pairs]
    false = [mcnemar_exact(*only_counts(pair.false)) for pair in pairs]
    p_values = zip(correct, holm(correct), false, holm(false), strict=True)
    tests = []
    for pair, p in zip(pairs, p_values, strict=True):
        only_correct, only_false = only_counts(pair.correct), only_counts(pair.false)
        tests.append(PairTest(pair.first, pair.second, len(pair.sources), *only_correct, *p[:2], *only_false, *p[2:]))
    return tests


def _median(values: Floats) -> float | None:
    return _quantile(values, 0.5)


def _quantile(values: Floats, q: float) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.quantile(known, q)) if len(known) else None
