"""The figures of a comparison: the trials as a table, counts with intervals, paired tests, the reliability of risks.

The *wait* of a trial is the number of frames after the start frame until the first correct map; 1 is the least
possible. A trial without a correct map counts as its limit, which is the number of frames after the start frame that
the trial can read. The mean of these values is the restricted mean of the wait. Trials of sequences without ground
truth, and of cameras that do not translate, have no wait. Trials of one sequence overlap and are not independent. The
intervals of the wait are therefore those of a bootstrap over sequences.

A method that states a risk of 0.002 is *reliable* if one in 500 of such maps is false. The maps are therefore counted
in bins of their stated risk (:data:`RISK_EDGES`). The expected number of false maps of a bin is the sum of the stated
risks of its maps. Only maps of sequences with a sound ground truth are counted.

A method also states standard deviations of the pair of its map, for the rotation and for the direction of the baseline.
The *coverage* is the share of the maps whose pair has an error within 2.80 standard deviations of the rotation, or
within 2.45 of the direction. With exact standard deviations it is 95 % or more: 95 % if the error is equally uncertain
about all axes, and more otherwise, because a stated deviation is that of the most uncertain axis. Maps of a camera that
does not translate have no true direction, so they have no coverage.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from slam_init.compare.criteria import NOT_EVALUATED, Truth, criteria_of
from slam_init.compare.rows import COLUMNS, TrialRow
from slam_init.compare.sources import focal_error_of
from slam_init.compare.statistics import Interval, cluster_mean, holm, mcnemar_exact, restricted_mean, wilson
from slam_init.compare.trials import Plan
from slam_init.datasets.synth import POINTS

if TYPE_CHECKING:
    from pandas import DataFrame, Series

#: Figures by their name, as in ``summary.json``; intervals are not yet lists there.
Figures: TypeAlias = Mapping[str, Any]

#: Trials that are counted together, and the heading of each part. Images and tracks without images (points) are counted
#: separately. So are the trials in which the camera does not translate (static or rotation-only), because no map can be
#: correct there.
PARTS = {
    "image_moving": "images, moving camera",
    "image_static": "images, no translation",
    "points_moving": "points, moving camera",
    "points_static": "points, no translation",
}
#: The two levels of trials: the parts whose names begin with the name of a level belong to it.
LEVELS = {"image": "images", "points": "points"}
#: Edges of the bins of the stated risk. A bin holds its upper edge, because a map is accepted up to and with a risk of
#: 0.005. The first bin also holds 0.
RISK_EDGES = (0.0, 0.001, 0.002, 0.005, 0.05, 1.0)
#: A Gaussian error lies within this number of standard deviations with a probability of 95 %: square roots of the 95th
#: percentiles of chi-square with two degrees of freedom (direction) and with three (rotation).
DIRECTION_SIGMAS, ROTATION_SIGMAS = 2.45, 2.80
#: An audit calls a map wrong above this risk (:class:`slam_init.types.audit.Audit`).
_AUDITED_WRONG = 0.9
#: Columns whose medians over the correct maps are reported.
_MEDIANS_OF_CORRECT = (
    "rotation_error_deg", "direction_error_deg", "ate", "rotation_error_before_deg", "direction_error_before_deg",
    "ate_before", "survival", "depth_error", "depth_order_error", "landmarks",
)  # fmt: skip
#: Version 2 added the figures of ambiguous planes and of suspected focal lengths. Version 3 renamed the parts
#: ``image_still`` and ``points_still`` to ``image_static`` and ``points_static``. Version 4 added ``min_left``,
#: ``criteria``, ``wait``, ``waits`` and ``reliability``. Version 5 added the figures of the audit, and version 6
#: renamed the key ``criteria``.
_SCHEMA = 6


#: The figures of a set of trials, by their name in ``summary.json``. A *rate* is a share with Wilson's interval.
FIGURES: dict[str, Callable[[DataFrame], Any]] = {
    "trials": len,
    # Number of trials with each outcome; ``accepted`` counts all maps.
    "correct": lambda t: _count(t["outcome"] == "correct"),
    "strict": lambda t: _count((t["outcome"] == "correct") & t["strict"].eq(True)),
    "false": lambda t: _count(t["outcome"] == "false"),
    "none": lambda t: _count(t["outcome"] == "none"),
    "error": lambda t: _count(t["outcome"] == "error"),
    "accepted": lambda t: _count(t["outcome"].isin(["correct", "false", "accepted"])),
    # Shares of the evaluated trials with a correct map, and with a false one, and of the right ones of the maps.
    "correct_rate": lambda t: _rate(t["outcome"][t["evaluated"]] == "correct"),
    "false_rate": lambda t: _rate(t["outcome"][t["evaluated"]] == "false"),
    "precision": lambda t: _rate(t["outcome"][t["outcome"].isin(["correct", "false"])] == "correct"),
    # Restricted means of the frames until the first map, and until a correct map. A trial without one counts as its
    # limit.
    "frames_to_accept": lambda t: restricted_mean(t["frames_to_accept"], t["frames_limit"]),
    "frames_to_correct": lambda t: restricted_mean(_of_correct(t, "frames_to_accept"), t["frames_limit"]),
    "wait": lambda t: _mean_by_sequence(t.set_index("source")["wait"].dropna()),
    "seconds_to_accept": lambda t: restricted_mean(t["seconds_to_accept"].dropna()),
    # Of the trials with an expected reason, the share that ended with this reason.
    "reason_accuracy": lambda t: _rate(t["reason_right"].dropna()),
    # Number of trials that ended with an ambiguous plane, and the share in which a stored hypothesis is correct.
    "undecided": lambda t: _count(t["kept_truth"].notna()),
    "kept_truth_rate": lambda t: _rate(t["kept_truth"].dropna()),
    # Of the trials with a wrong stated focal length, the share in which an attempt suspects it, and in which the result
    # reports it; of the trials with the true one, the share in which the result reports that it is wrong.
    "suspicion_rate": lambda t: _rate(t["suspected_focal_factor"][t["wrong_focal"]].notna()),
    "report_rate": lambda t: _rate(t["reported_focal_factor"][t["wrong_focal"]].notna()),
    "false_report_rate": lambda t: _rate(t["reported_focal_factor"][~t["wrong_focal"]].notna()),
    # Mean over the maps of the probability that they are wrong, by the audit, and the share that the audit calls wrong.
    # With reliable risks the mean is the share of the false ones.
    "audited_risk": lambda t: float(t["audited_risk"].mean()) if t["audited_risk"].notna().any() else None,
    "audited_wrong_rate": lambda t: _rate(t["audited_risk"].dropna() > _AUDITED_WRONG),
    # Number of trials without a map, by their reason or error message.
    "reasons": lambda t: _reasons(t["reason"][t["outcome"].isin(["none", "error"])]),
    # Medians over the correct maps; None without one.
    "medians": lambda t: {name: _quantile(_of_correct(t, name), 0.5) for name in _MEDIANS_OF_CORRECT},
    "peak_memory_mb": lambda t: _quantile(t["peak_memory_mb"], 1.0),
    "frame_median_ms": lambda t: _quantile(t["frame_median_ms"], 0.5),
    "attempt_median_ms": lambda t: _quantile(t["attempt_median_ms"], 0.5),
    "trial_ms": lambda t: _quantile(t["trial_ms"], 0.5),
    # 95th percentile over the trials of the 95th percentile over the frames of a trial.
    "frame_p95_ms": lambda t: _quantile(t["frame_p95_ms"], 0.95),
}


def figures_of(table: DataFrame) -> Figures:
    """Compute the figures of a set of trials."""
    return {name: compute(table) for name, compute in FIGURES.items()}


def table_of(rows: Iterable[TrialRow]) -> DataFrame:
    """Make a table of the trials: the columns of the rows, and what follows from the group and the source of each.

    ``part`` is a key of :data:`PARTS`. ``evaluated`` trials have a ground truth. In ``solvable`` trials a map can be
    correct: they have a ground truth, and the camera translates. ``sound`` trials have a sound ground truth. ``wait``
    is NaN for a trial without one.
    """
    from pandas import DataFrame

    table = DataFrame(list(rows), columns=list(COLUMNS))
    table = table.astype({name: float for name, kind in COLUMNS.items() if kind.startswith(("int", "float"))})
    criteria = {group: criteria_of(group) for group in table["group"].unique()}
    levels = {group: "points" if group.startswith(POINTS) else "image" for group in criteria}
    moving = {group: "static" if one.no_translation else "moving" for group, one in criteria.items()}
    table["part"] = table["group"].map({group: f"{levels[group]}_{moving[group]}" for group in criteria})
    sound = table["group"].map({group: one.truth is Truth.SOUND for group, one in criteria.items()}).astype(bool)
    evaluated = (table["evaluated_by"] != NOT_EVALUATED.rule) & (table["outcome"] != "accepted")
    translates = table["part"].str.endswith("moving")
    table["evaluated"], table["solvable"], table["sound"] = evaluated, evaluated & translates, evaluated & sound
    table["wrong_focal"] = [focal_error_of(source) != 0 for source in table["source"]]
    waited = _of_correct(table, "frames_to_accept").fillna(np.inf).clip(upper=table["frames_limit"]) - 1
    table["wait"] = waited.where(table["solvable"])
    return table


def pair_tests(table: DataFrame, methods: Sequence[str]) -> Sequence[Figures]:
    """Test every pair of methods on the trials that both ran, by McNemar's exact test.

    * Returns: For each pair the number of trials in which only one of the methods found a correct map, or a false one,
      and the p-values that both do so equally often, also adjusted for the number of pairs (Holm).
    """
    outcomes = _by_trial(table, "outcome", methods)
    shared = {pair: outcomes[list(pair)].dropna() for pair in combinations(methods, 2)}
    tests: list[dict[str, Any]] = [{"first": a, "second": b, "trials": len(shared[a, b])} for a, b in shared]
    for kind in ("correct", "false"):
        for test, ((first, second), both) in zip(tests, shared.items(), strict=True):
            one, other = both[first] == kind, both[second] == kind
            only = _count(one & ~other), _count(other & ~one)
            test[f"only_first_{kind}"], test[f"only_second_{kind}"] = only
            test[f"p_{kind}"] = mcnemar_exact(*only)
        for test, p_value in zip(tests, holm([test[f"p_{kind}"] for test in tests]), strict=True):
            test[f"p_{kind}_holm"] = p_value
    return tests


def wait_differences(table: DataFrame, methods: Sequence[str]) -> Sequence[Figures]:
    """Compare the wait of the first method with that of each other method, trial by trial.

    * Returns: For each other method the number of trials that both ran and that have a wait, and of their sequences,
      and the mean of the wait of the first method minus that of the other one. Its interval is that of a bootstrap over
      sequences; its ends are NaN for a single sequence.
    """
    waits = _by_trial(table, "wait", methods)
    differences = {other: (waits[methods[0]] - waits[other]).dropna() for other in methods[1:]}
    return [
        {"first": methods[0], "second": other, "trials": len(one)}
        | {"sequences": one.index.unique("source").size, "difference_frames": _mean_by_sequence(one)}
        for other, one in differences.items()
    ]


def reliability_of(table: DataFrame) -> Figures | None:
    """Compare the stated risks with the outcomes: of the maps with a stated risk and a sound ground truth.

    * Returns: The bins of :data:`RISK_EDGES`, all maps, and the coverage of the rotation and of the direction; None
      without such a map.
    """
    table = table[table["outcome"].isin(["correct", "false"]) & table["sound"] & table["risk"].notna()]
    if not len(table):
        return None
    position = np.digitize(table["risk"], RISK_EDGES[1:-1], right=True)
    solvable = table[table["solvable"]]
    return {
        "bins": [_bin(table[position == k], low, high) for k, (low, high) in enumerate(pairwise(RISK_EDGES))],
        "total": _bin(table, RISK_EDGES[0], RISK_EDGES[-1]),
        "rotation": _coverage(solvable, "rotation", ROTATION_SIGMAS),
        "direction": _coverage(solvable, "direction", DIRECTION_SIGMAS),
    }


def _bin(table: DataFrame, low: float, high: float) -> Figures:
    """The maps with a stated risk above ``low`` and at most ``high``; a ``low`` of 0 belongs to the range."""
    false, expected = table["outcome"] == "false", math.fsum(table["risk"])
    stated = {"mean_risk": expected / len(table) if len(table) else math.nan, "expected_false": expected}
    return {"low": low, "high": high, "maps": len(table), **stated, "false": _count(false), "false_rate": _rate(false)}


def _coverage(table: DataFrame, name: str, sigmas: float) -> Figures:
    """The maps with a known error, and those whose error lies within the stated standard deviations."""
    known = table[[f"pair_{name}_error_deg", f"{name}_sigma_deg"]].dropna()
    within = known.iloc[:, 0] <= sigmas * known.iloc[:, 1]
    return {"maps": len(known), "within": _count(within), "rate": _rate(within)}


def summary_of(table: DataFrame, plan: Plan) -> Figures:
    """Compute all figures of a comparison: the content of ``summary.json``, before numbers are rounded.

    Only the times and the peak memory differ from run to run. Parts, levels and methods without a figure are left out.
    """
    parts = {name: table[table["part"] == name] for name in PARTS if (table["part"] == name).any()}
    levels = {name: _split(table[table["part"].str.startswith(name)], plan.methods).items() for name in LEVELS}
    stated = {
        name: {method: one for method, of_method in split if (one := reliability_of(of_method)) is not None}
        for name, split in levels.items()
    }
    moving = {name: part for name, part in parts.items() if name.endswith("moving")}
    return {
        "schema": _SCHEMA,
        "seed": plan.settings.seed,
        "every": plan.every,
        "min_left": plan.min_left,
        "limit_frames": plan.settings.limit_frames,
        "limit_s": plan.settings.limit_s,
        "trials": len(table),
        "methods": plan.methods,
        "sources": [source.label for source in plan.sources],
        "criteria": {source.group: source.criteria for source in sorted(plan.sources, key=lambda one: one.group)},
        "parts": {name: _figures(part, plan.methods) for name, part in parts.items()},
        "groups": {str(group): _figures(of_group, plan.methods) for group, of_group in table.groupby("group")},
        "pairs": {name: pair_tests(part, plan.methods) for name, part in parts.items()},
        "waits": {name: wait_differences(part, plan.methods) for name, part in moving.items()},
        "reliability": {name: by_method for name, by_method in stated.items() if by_method},
    }


def _split(table: DataFrame, methods: Sequence[str]) -> dict[str, DataFrame]:
    return {method: table[table["method"] == method] for method in methods}


def _figures(table: DataFrame, methods: Sequence[str]) -> dict[str, Figures]:
    return {method: figures_of(of_method) for method, of_method in _split(table, methods).items()}


def _by_trial(table: DataFrame, column: str, methods: Sequence[str]) -> DataFrame:
    """Arrange a column by trial (rows) and method."""
    return table.pivot(index=["source", "start"], columns="method", values=column).reindex(columns=list(methods))


def _mean_by_sequence(values: Series[float]) -> Interval:
    """The mean of values with the source of each in their index."""
    return cluster_mean(values.to_numpy(), values.index.get_level_values("source").to_numpy(object))


def _of_correct(table: DataFrame, column: str) -> Series[float]:
    """A column of numbers, which are known of the correct maps only."""
    return table[column].where(table["outcome"] == "correct")


def _reasons(reasons: Series[str]) -> dict[str, int]:
    """The number of each reason, the most frequent one first."""
    return dict(sorted(Counter(reasons.fillna("")).items(), key=lambda item: (-item[1], item[0])))


def _rate(flags: Series[bool]) -> Interval:
    return wilson(_count(flags), len(flags))


def _count(flags: Series[bool]) -> int:
    return int(flags.sum())


def _quantile(values: Series[float], q: float) -> float | None:
    known = values.dropna()
    return float(np.quantile(known, q)) if len(known) else None
