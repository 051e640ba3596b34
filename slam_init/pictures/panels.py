"""Parts of a picture: frames with tracks, the pair with its matches, and the decision over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from slam_init.pictures.story import MatchedImages, ShownFrame
from slam_init.pictures.style import FAINT, INK, INLIER, MOVING, OUTLIER, TRACK, VERDICT_COLORS, rgb
from slam_init.types.arrays import Bools, Floats, Image
from slam_init.types.gates import GateName
from slam_init.types.reasons import Verdict, in_words
from slam_init.types.result import Attempt

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: More lines cannot be told apart.
_MOST_LINES = 90
#: Images that are wider than this are put one above the other.
_WIDE = 1.8
#: Smallest risk on the axis of the decision: ten times below the smallest bound in use.
_LEAST_RISK = 1e-4
#: The terms of the risk, their names and their dashes.
_TERMS = (
    ("risk_direction", "direction", "-"),
    ("risk_rival", "another motion", "--"),
    ("risk_rotation", "only rotation", ":"),
    ("risk_moving", "moving bodies", "-."),
)


#: Most attempts of a failure whose risk is drawn with its terms.
_MOST_WITH_TERMS = 40
#: Longest track that is drawn from one shown frame to the next, as a share of the width of the image.
LONGEST_TAIL = 0.15


def draw_frame(
    axes: Axes, shown: ShownFrame, before: ShownFrame | None, width: int, landmarks: Bools | None = None
) -> None:
    """Draw a frame, its tracks, and how the tracks moved since an earlier frame: ``landmarks`` (N,)."""
    from matplotlib.collections import LineCollection

    _image(axes, shown.image, f"frame {shown.index}")
    scale = shown.image.shape[1] / width
    places = _shown(shown.pixels, scale)
    if before is not None:
        _, i, j = np.intersect1d(before.track_ids, shown.track_ids, return_indices=True)
        # A longer one is no path of a point: descriptors linked the frames, as photographs and after a cut.
        flowed = np.linalg.norm(shown.pixels[j] - before.pixels[i], axis=1) <= LONGEST_TAIL * width
        tails = np.stack([_shown(before.pixels[i[flowed]], scale), places[j[flowed]]], axis=1)
        axes.add_collection(LineCollection(list(tails), colors=TRACK, linewidths=0.6, alpha=0.7), autolim=False)
    chosen = np.zeros(len(places), bool) if landmarks is None else landmarks
    for part, color in ((places[~chosen], TRACK), (places[chosen], INLIER)):
        axes.plot(part[:, 0], part[:, 1], ".", color=color, markersize=3.0, markeredgewidth=0)


def draw_pair(axes: Axes, pair: MatchedImages, width: int) -> None:
    """Draw two images side by side with their matches; wide images one above the other."""
    from matplotlib.collections import LineCollection

    first, second = (rgb(image) for image in pair.images)
    height, wide = first.shape[0], first.shape[1] > _WIDE * first.shape[0]
    gap = np.full((4, first.shape[1], 3) if wide else (height, 4, 3), 255, np.uint8)
    both = np.concatenate([first, gap, second], axis=0 if wide else 1)
    offset = np.array((0, height + 4) if wide else (first.shape[1] + 4, 0), float)
    scale = first.shape[1] / width
    ends = np.stack([_shown(pair.pixels1, scale), _shown(pair.pixels2, scale) + offset], axis=1)
    step = max(1, -(-len(ends) // _MOST_LINES))
    drawn = np.arange(len(ends)) % step == 0
    outliers = ~pair.inliers & ~pair.moving
    parts = (
        ("outliers" if pair.judged else "tracks, no motion estimated", outliers, OUTLIER if pair.judged else TRACK),
        ("inliers", pair.inliers, INLIER),
        ("moving bodies", pair.moving, MOVING),
    )
    _image(axes, both, "", in_rgb=True)
    for name, chosen, color in parts:
        if not chosen.any() and name != "inliers":
            continue
        if not pair.judged and name == "inliers":
            continue
        axes.add_collection(
            LineCollection(list(ends[chosen & drawn]), colors=color, linewidths=0.6, alpha=0.8), autolim=False
        )
        dots = ends[chosen].reshape(-1, 2)
        label = f"{name}: {np.count_nonzero(chosen)}"
        axes.plot(dots[:, 0], dots[:, 1], ".", color=color, markersize=2.2, markeredgewidth=0, label=label)
    axes.set_title(f"the pair: frames {pair.frames[0]} and {pair.frames[1]}", loc="left", color=INK, weight="bold")
    if not axes.get_legend_handles_labels()[0]:
        return
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.01), ncol=3, fontsize=9, frameon=False, markerscale=5, borderpad=0.2
    )


def draw_decision(axes: Axes, attempts: Sequence[Attempt]) -> None:
    """Draw the risk of each attempt with its terms and the bound, and below them what held the decision."""
    from matplotlib.ticker import MaxNLocator

    axes.set_title("the decision: risk that the map is wrong", loc="left", color=INK, weight="bold")
    axes.set_xlabel("frame", fontsize=9, labelpad=1)
    axes.tick_params(labelsize=9, colors=FAINT)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    strip_top, lowest = _LEAST_RISK, _LEAST_RISK / 4
    axes.set_yscale("log")
    axes.set_ylim(lowest, 1.6)
    axes.set_yticks([1e-4, 1e-3, 1e-2, 1e-1, 1], ["0.0001", "0.001", "0.01", "0.1", "1"])
    axes.minorticks_off()
    if not attempts:
        axes.text(0.5, 0.5, "no pair was tried", transform=axes.transAxes, ha="center", color=FAINT)
        return
    frames = np.array([attempt.frames[min(1, len(attempt.frames) - 1)] for attempt in attempts])
    first, last = int(frames.min()), int(frames.max())
    axes.set_xlim(first - 0.5, last + 0.5)
    axes.xaxis.set_major_locator(MaxNLocator("auto", integer=True, min_n_ticks=1))
    # The terms explain what was accepted. Over a long wait they are zigzags that hide the risk.
    if attempts[-1].verdict == Verdict.ACCEPTED or len(attempts) <= _MOST_WITH_TERMS:
        _draw_terms(axes, frames, attempts)
    _draw_risk(axes, frames, attempts)
    _draw_strip(axes, frames, attempts, lowest, strip_top)


def _draw_terms(axes: Axes, frames: Floats, attempts: Sequence[Attempt]) -> None:
    """The terms that ever exceed the smallest risk that is shown, as thin grey lines."""
    for name, label, dashes in _TERMS:
        values = _with_gaps([None if one.window is None else float(getattr(one.window, name)) for one in attempts])
        lines = ~np.isnan(values[1:] + values[:-1])  # a single value makes no line
        if lines.any() and np.nanmax(values) > _LEAST_RISK:
            shown = np.clip(values, _LEAST_RISK, 1.0)
            axes.plot(frames, shown, linestyle=dashes, color=FAINT, linewidth=1.0, label=f"part of it: {label}")


def _draw_risk(axes: Axes, frames: Floats, attempts: Sequence[Attempt]) -> None:
    bound = next((g.threshold for one in reversed(attempts) for g in one.gates if g.name is GateName.RISK), None)
    if bound is not None:
        axes.axhline(bound, color=OUTLIER, linewidth=1.4, label=f"bound {bound:g}")
    risks = _with_gaps([None if one.window is None else one.window.risk for one in attempts])
    if np.isnan(risks).all():
        words = "no motion was estimated, so there is no risk to state"
        axes.text(0.5, 0.62, words, transform=axes.transAxes, ha="center", color=FAINT)
        return
    shown = np.clip(risks, _LEAST_RISK, 1.0)
    known = ~np.isnan(shown)
    axes.plot(frames[known], shown[known], "-", color=INK, linewidth=0.8, alpha=0.4)  # across frames without a risk
    axes.plot(frames, shown, "-", color=INK, linewidth=1.6, label="risk")
    colors = [VERDICT_COLORS[attempt.verdict] for attempt in attempts]
    size = float(np.clip(300 / len(frames), 2.5, 7))
    axes.scatter(frames, shown, s=size**2, c=colors, linewidths=0, zorder=3)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), fontsize=8, frameon=False, borderpad=0.1)


def _draw_strip(axes: Axes, frames: Floats, attempts: Sequence[Attempt], low: float, high: float) -> None:
    """A strip of the verdicts by frame, and their legend."""
    from matplotlib.patches import Patch

    seen = [verdict for verdict in Verdict if any(one.verdict == verdict for one in attempts)]
    steps = np.diff(np.unique(frames))
    step = float(np.median(steps)) if len(steps) else 1.0  # --every 3 leaves no holes
    for verdict in seen:
        held = [frame for frame, one in zip(frames, attempts, strict=True) if one.verdict == verdict]
        spans = [(frame - 0.5 * step, step) for frame in held]
        axes.broken_barh(spans, (low, high - low), color=VERDICT_COLORS[verdict], linewidth=0)
    counts = [sum(one.verdict == verdict for one in attempts) for verdict in seen]
    handles = [
        Patch(color=VERDICT_COLORS[verdict], label=f"{in_words(verdict)} ({count})")
        for verdict, count in zip(seen, counts, strict=True)
    ]
    before = axes.get_legend()
    axes.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(1.0, -0.12),
        fontsize=8,
        frameon=False,
        borderpad=0.1,
        title="what held it",
        title_fontsize=8,
        alignment="left",
    )
    if before is not None:
        axes.add_artist(before)


def _with_gaps(values: Sequence[float | None]) -> Floats:
    return np.array([np.nan if value is None else value for value in values])


def _shown(pixels: Floats, scale: float) -> Floats:
    """Pixels of the image as it was read -> pixels of its small copy, both with centres at integers."""
    return (pixels + 0.5) * scale - 0.5


def _image(axes: Axes, image: Image, title: str, *, in_rgb: bool = False) -> None:
    axes.imshow(image if in_rgb else rgb(image), interpolation="bilinear")
    axes.set_xlim(-0.5, image.shape[1] - 0.5)
    axes.set_ylim(image.shape[0] - 0.5, -0.5)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    if title:
        axes.set_title(title, fontsize=9, color=FAINT, pad=3)
