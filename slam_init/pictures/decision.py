"""Draws the decision of a run: the risk of each attempt, its terms, its bound, and what held it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from slam_init.pictures.canvas import FAINT, INK, INLIER, OUTLIER
from slam_init.types.arrays import Floats
from slam_init.types.refusal import GateName, Verdict, in_words
from slam_init.types.result import Attempt

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Smallest risk on the axis of the decision: ten times below the smallest bound in use.
_LEAST_RISK = 1e-4
#: The terms of the risk, their names and their dashes.
_TERMS = (
    ("risk_direction", "direction", "-"),
    ("risk_competing", "another motion", "--"),
    ("risk_rotation", "only rotation", ":"),
    ("risk_moving", "moving objects", "-."),
)
#: Most attempts of a failure whose risk is plotted with its terms.
_MOST_WITH_TERMS = 40
#: One colour for what holds the decision: no motion blue, no scene brown, no common motion purple, flat orange, unknown
#: lens yellow, the map pink, accepted green.
VERDICT_COLORS: dict[Verdict, str] = {
    Verdict.STATIC_CAMERA: "#7d8fa3",
    Verdict.PURE_ROTATION: "#4f7cac",
    Verdict.LOW_PARALLAX: "#2aa3cf",
    Verdict.TOO_FEW_FEATURES: "#a98467",
    Verdict.TOO_FEW_MATCHES: "#7f5539",
    Verdict.NO_CONSISTENT_MOTION: "#8e44ad",
    Verdict.MOVING_OBJECTS: "#b478e6",
    Verdict.AMBIGUOUS_PLANE: "#f28c28",
    Verdict.UNKNOWN_FOCAL_LENGTH: "#b8a200",
    Verdict.WRONG_FOCAL_LENGTH: "#6b5900",
    Verdict.EXTERNAL_METHOD: "#566573",
    Verdict.TOO_FEW_LANDMARKS: "#d9749f",
    Verdict.BUNDLE_ADJUSTMENT_FAILED: "#c2185b",
    Verdict.TOO_FEW_FRAMES: "#777777",
    Verdict.ACCEPTED: INLIER,
}


def draw_decision(axes: Axes, attempts: Sequence[Attempt]) -> None:
    """Draw the risk of each attempt with its terms and the bound, and below them what held the decision."""
    from matplotlib.ticker import MaxNLocator

    axes.set_title("the decision: risk by the model that the map is wrong", loc="left", color=INK, weight="bold")
    axes.set_xlabel("frame", fontsize=9, labelpad=1)
    axes.tick_params(labelsize=9, colors=FAINT)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set(yscale="log", ylim=(_LEAST_RISK / 4, 1.6))
    axes.set_yticks([1e-4, 1e-3, 1e-2, 1e-1, 1], ["0.0001", "0.001", "0.01", "0.1", "1"])
    axes.minorticks_off()
    if not attempts:
        axes.text(0.5, 0.5, "no pair was tried", transform=axes.transAxes, ha="center", color=FAINT)
        return
    frames = np.array([attempt.frames[min(1, len(attempt.frames) - 1)] for attempt in attempts])
    axes.set_xlim(int(frames.min()) - 0.5, int(frames.max()) + 0.5)
    axes.xaxis.set_major_locator(MaxNLocator("auto", integer=True, min_n_ticks=1))
    # The terms explain what was accepted. Over a long wait they are zigzags that hide the risk.
    if attempts[-1].verdict == Verdict.ACCEPTED or len(attempts) <= _MOST_WITH_TERMS:
        _draw_terms(axes, frames, attempts)
    _draw_risk(axes, frames, attempts)
    _draw_strip(axes, frames, attempts)


def _risks(attempts: Sequence[Attempt], name: str) -> Floats:
    """A figure of the window of each attempt, NaN where none was evaluated."""
    return np.array([np.nan if one.window is None else float(getattr(one.window, name)) for one in attempts])


def _draw_terms(axes: Axes, frames: Floats, attempts: Sequence[Attempt]) -> None:
    """The terms that ever exceed the smallest risk that is shown, as thin grey lines."""
    for name, label, dashes in _TERMS:
        values = _risks(attempts, name)
        lines = ~np.isnan(values[1:] + values[:-1])  # a single value makes no line
        if lines.any() and np.nanmax(values) > _LEAST_RISK:
            shown = np.clip(values, _LEAST_RISK, 1.0)
            axes.plot(frames, shown, linestyle=dashes, color=FAINT, linewidth=1.0, label=f"part: {label}")


def _draw_risk(axes: Axes, frames: Floats, attempts: Sequence[Attempt]) -> None:
    bound = next((g.threshold for one in reversed(attempts) for g in one.gates if g.name is GateName.RISK), None)
    if bound is not None:
        axes.axhline(bound, color=OUTLIER, linewidth=1.4, label=f"bound {bound:g}")
    shown = np.clip(_risks(attempts, "risk"), _LEAST_RISK, 1.0)
    known = ~np.isnan(shown)
    if not known.any():
        words = "no motion was estimated, so there is no risk to state"
        axes.text(0.5, 0.62, words, transform=axes.transAxes, ha="center", color=FAINT)
        return
    axes.plot(frames[known], shown[known], "-", color=INK, linewidth=1.2, label="risk")  # a frame with one has a dot
    colors = [VERDICT_COLORS[attempt.verdict] for attempt in attempts]
    size = float(np.clip(300 / len(frames), 2.5, 7))
    axes.scatter(frames, shown, s=size**2, c=colors, linewidths=0, zorder=3, clip_on=False)
    axes.add_artist(axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02)))  # the strip has another one


def _draw_strip(axes: Axes, frames: Floats, attempts: Sequence[Attempt]) -> None:
    """A strip of the verdicts by frame, and their legend."""
    from matplotlib.patches import Patch

    counts = Counter(attempt.verdict for attempt in attempts)
    seen = [verdict for verdict in Verdict if verdict in counts]
    steps = np.diff(np.unique(frames))
    step = float(np.median(steps)) if len(steps) else 1.0  # --every 3 leaves no holes
    for verdict in seen:
        spans = [(at - 0.5 * step, step) for at, one in zip(frames, attempts, strict=True) if one.verdict == verdict]
        axes.broken_barh(spans, (_LEAST_RISK / 4, 0.75 * _LEAST_RISK), color=VERDICT_COLORS[verdict], linewidth=0)
    handles = [Patch(color=VERDICT_COLORS[one], label=f"{in_words(one)} ({counts[one]})") for one in seen]
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(1.0, -0.02), title="what held it", alignment="left")
