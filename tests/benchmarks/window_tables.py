"""The tables of :mod:`tests.benchmarks.window_fit`."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence

import numpy as np

from slam_init.compare.statistics import wilson
from slam_init.output.tables import markdown_table, number
from tests.benchmarks.window_log import Window

#: Bins of the stated risk.
RISK_BINS = (
    (0.0, 0.0006),
    (0.0006, 0.001),
    (0.001, 0.002),
    (0.002, 0.005),
    (0.005, 0.02),
    (0.02, 0.05),
    (0.05, 0.5),
    (0.5, 1.0),
)
#: Coverage and NEES are those of the windows with a risk up to this one: the expansion of the cost says nothing about
#: windows of a wrong hypothesis.
CERTAIN_RISK = 0.05
#: Largest accepted risks, about the default of 0.005.
_LIMITS = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
#: Chi-square: the value that 95 % do not exceed, and the median, by degrees of freedom.
_CHI2_95 = {2: 5.991, 3: 7.815}
_CHI2_MEDIAN = {1: 0.4549, 2: 1.3863, 3: 2.3660}


def window_report(windows: Sequence[Window], max_risk: float) -> str:
    """All tables, those of drawn worlds apart from those of real sequences."""
    parts = []
    for title, own in (
        ("Drawn worlds", [w for w in windows if w.baseline > 0]),
        ("Real sequences", [w for w in windows if w.baseline == 0]),
    ):
        if not own:
            continue
        certain = [w for w in own if w.risk is not None and w.risk.total <= CERTAIN_RISK]
        counts = f"{len(own)} windows, {sum(w.risk is not None for w in own)} with a proposed motion"
        parts += [
            f"## {title}",
            f"{counts}, {len(certain)} with a risk up to {CERTAIN_RISK:g}.",
            reliability_table(own),
            exchange_table(own),
            rule_table(own, max_risk),
            f"Share of the errors within the 95 % interval, windows with a risk up to {CERTAIN_RISK:g}:",
            coverage_table(certain),
            "Squared errors in units of the stated covariance (NEES), over their expectation: mean / median, where the "
            "median is over that of chi-square. 1 is right, less is too cautious:",
            nees_table(certain, lambda w: w.scene, "scene"),
            nees_table(sorted(certain, key=lambda w: w.views), lambda w: w.views, "views"),
        ]
    return "\n\n".join(parts)


def reliability_table(windows: Sequence[Window]) -> str:
    """Stated risk against the share of wrong windows, with its 95 % interval (Wilson).

    The windows of a world depend on each other, so that the interval is too narrow.
    """
    rows = []
    for low, high in RISK_BINS:
        inside = [(w, w.risk) for w in windows if w.risk is not None and _is_within(w.risk.total, low, high)]
        wrong = sum(w.wrong for w, _ in inside)
        stated = float(np.mean([risk.total for _, risk in inside])) if inside else math.nan
        share = wilson(wrong, len(inside))
        rows.append(
            [
                f"{low:g} to {high:g}",
                str(len(inside)),
                number(100 * stated, 3),
                str(wrong),
                number(100 * share.value),
                f"{number(100 * share.low)} to {number(100 * share.high)}" if inside else "-",
            ]
        )
    return markdown_table(["stated risk", "windows", "mean risk %", "wrong", "wrong %", "95 % interval"], rows)


def exchange_table(windows: Sequence[Window]) -> str:
    """Accepting the first window of a trial with a risk up to some limit: how much sooner, and how often wrong.

    A trial without a correct map counts as its longest window.
    """
    trials = [own for _, own in _grouped(windows, lambda w: (w.scene, w.baseline, w.start))][:-1]
    rows = []
    for limit in _LIMITS:
        correct = false = frames = 0
        for own in trials:
            first = next((w for w in own if w.risk is not None and w.risk.total <= limit), None)
            right = first is not None and not first.wrong
            correct, false = correct + right, false + (first is not None and not right)
            frames += first.views - 1 if first is not None and right else max(w.views for w in own)
        interval = wilson(false, len(trials))
        counts = f"{correct}/{false}/{len(trials) - correct - false}"
        rows.append(
            [
                f"{limit:g}",
                counts,
                f"{100 * interval.low:.2f} to {100 * interval.high:.2f}",
                f"{frames / len(trials):.2f}",
            ]
        )
    return markdown_table(["largest risk", "correct/false/none", "false %, 95 % interval", "wait (frames)"], rows)


def rule_table(windows: Sequence[Window], max_risk: float) -> str:
    """What a rule on the risk accepts first in each trial, beside the time."""
    rows = []
    for scene, baseline in dict.fromkeys((w.scene, w.baseline) for w in windows):
        own = [w for w in windows if (w.scene, w.baseline) == (scene, baseline)]
        trials: dict[str, list[Window]] = {}
        for window in own:
            trials.setdefault(window.start, []).append(window)
        first = [next((w for w in one if w.risk and w.risk.total <= max_risk), None) for one in trials.values()]
        false = sum(w.wrong for w in first if w is not None)
        # A trial without a correct map counts as its longest window.
        longest = [max(w.views for w in one) for one in trials.values()]
        waits = [most if w is None or w.wrong else w.views - 1 for w, most in zip(first, longest, strict=True)]
        taken = sum(w is not None for w in first)
        rows.append(
            [
                f"{scene} {baseline:g}" if baseline else scene,
                f"{taken - false}/{false}/{len(trials) - taken}",
                f"{np.mean(waits):.1f}",
                f"{np.median([w.milliseconds for w in own if w.risk is not None] or [math.nan]):.0f}",
            ]
        )
    return markdown_table(["scene, baseline", "correct/false/none", "wait (frames)", "ms a window"], rows)


def coverage_table(windows: Sequence[Window]) -> str:
    """Share of the errors within the 95 % interval: rotation, direction and distances, in per cent."""
    header = [
        "scene",
        "windows",
        "rotation",
        "direction",
        "direction with scatter",
        "distances",
        "of the median window",
    ]
    rows = []
    for scene, own in _grouped(windows, lambda w: w.scene):
        accuracies = [w.accuracy for w in own]
        tracks = sum(a.depth_tracks for a in accuracies)
        shares = [a.depth_covered / a.depth_tracks for a in accuracies if a.depth_tracks]
        rows.append(
            [
                scene,
                str(len(own)),
                _covered([a.rotation_nees for a in accuracies], 3),
                _covered([a.direction_nees for a in accuracies], 2),
                _covered([a.scattered_direction_nees for a in accuracies], 2),
                f"{100 * sum(a.depth_covered for a in accuracies) / tracks:.1f}" if tracks else "-",
                f"{100 * np.median(shares):.1f}" if shares else "-",
            ]
        )
    return markdown_table(header, rows)


def nees_table(windows: Sequence[Window], key: Callable[[Window], Hashable], title: str) -> str:
    """Mean and median of the normalized squared errors over their expectations, for each group of windows."""
    rows = []
    for name, own in _grouped(windows, key):
        accuracies = [w.accuracy for w in own]
        rows.append(
            [
                name,
                str(len(own)),
                _mean_median([a.rotation_nees for a in accuracies], 3),
                _mean_median([a.direction_nees for a in accuracies], 2),
                _mean_median([a.scattered_direction_nees for a in accuracies], 2),
                # The figure of a window is the median over its tracks, over that of chi-square.
                _mean_median([a.depth_median_nees / _CHI2_MEDIAN[1] for a in accuracies], 0),
            ]
        )
    return markdown_table([title, "windows", "rotation", "direction", "direction with scatter", "distances"], rows)


def _is_within(risk: float, low: float, high: float) -> bool:
    return low <= risk < high or risk == high == 1.0


def _grouped(windows: Sequence[Window], key: Callable[[Window], Hashable]) -> list[tuple[str, list[Window]]]:
    """The windows of each group, and all of them."""
    groups: dict[Hashable, list[Window]] = {}
    for window in windows:
        groups.setdefault(key(window), []).append(window)
    return [*((str(name), own) for name, own in groups.items()), ("all", list(windows))]


def _covered(nees: Sequence[float], freedom: int) -> str:
    values = np.array([one for one in nees if math.isfinite(one)])
    return f"{100 * np.mean(values <= _CHI2_95[freedom]):.1f}" if len(values) else "-"


def _mean_median(nees: Sequence[float], freedom: int) -> str:
    """Both over their expectation; of figures that have one of 1 with 0 degrees of freedom."""
    values = np.array([one for one in nees if math.isfinite(one)])
    if not len(values):
        return "-"
    mean, median = (freedom, _CHI2_MEDIAN[freedom]) if freedom else (1, 1)
    return f"{values.mean() / mean:.2f} / {np.median(values) / median:.2f}"
