"""The parts of a picture of a run: the ground, frames and pairs, the decision, and maps."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from slam_init.errors import plain_line
from slam_init.recording.recorder import ShownFrame, ShownPair, bgr, match_parts
from slam_init.types.arrays import Bools, Floats, Image
from slam_init.types.initial_map import InitialMap
from slam_init.types.refusal import GateName, Verdict, in_words
from slam_init.types.result import Attempt

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: The colours of matches and paths are those of the recording.
INLIER, OUTLIER, MOVING, TRACK = "#2fb45a", "#e64646", "#b478e6", "#ffc828"
ESTIMATE, TRUTH = "#3ca0ff", "#ff9628"
INK, PAPER, FAINT, GROUND = "#1c2430", "#ffffff", "#6b7685", "#11161d"
#: Of matplotlib: texts in a font that it brings, and legends without a frame.
_STYLE: dict[Any, Any] = {
    "font.family": ["DejaVu Sans"],
    "font.size": 10,
    "axes.titlesize": 10,
    "legend.frameon": False,
    "legend.borderpad": 0.1,
    "legend.fontsize": 8,
    "legend.title_fontsize": 8,
}


@contextmanager
def canvas(width_px: int, height_px: int) -> Iterator[Figure]:
    """Make an empty figure, with matplotlib's own defaults instead of those of the user.

    * Returns: It has to be used in the ``with`` block.
    """
    import logging
    import warnings

    # Without a home folder matplotlib logs where its cache is, and each letter that its fonts do not have.
    log = logging.getLogger("matplotlib")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        import matplotlib
        from matplotlib.figure import Figure

        with matplotlib.rc_context(), warnings.catch_warnings():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(_STYLE)
            # A name may have letters that the font lacks: they are shown as boxes.
            warnings.filterwarnings("ignore", message=".*[Gg]lyph.*")
            yield Figure(figsize=(width_px / 100, height_px / 100), dpi=100, facecolor=PAPER)
    finally:
        log.setLevel(level)


def pixels_of(figure: Figure) -> Image:
    """Draw a figure: returns (H, W, 3)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    agg: Any = FigureCanvasAgg(figure)  # its stubs lack the drawing
    agg.draw()
    return np.asarray(agg.buffer_rgba())[..., :3]


def axes_at(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Add axes at a place in pixels from the left top of a figure."""
    size = figure.get_size_inches() * figure.dpi
    return figure.add_axes((left / size[0], 1 - (top + height) / size[1], width / size[0], height / size[1]))


def blank(axes: Axes) -> Axes:
    """Let axes hold text alone."""
    axes.axis("off")
    return axes


def write(axes: Axes, x: float, y: float, text: str, size: float, color: str = INK, weight: str = "normal") -> None:
    """Write a text at the left top of a place in axes that are otherwise empty."""
    place = axes.transAxes
    axes.text(x, y, text, transform=place, fontsize=size, color=color, weight=weight, va="top", parse_math=False)


def wrapped(text: str, columns: int, most_lines: int = 4) -> str:
    """Break a text of one line into several."""
    return "\n".join(textwrap.wrap(plain_line(text), columns, max_lines=most_lines, placeholder=" ..."))


# -- frames and pairs ------------------------------------------------------------------------------


#: More lines between the images of a pair cannot be distinguished.
_MOST_LINES = 90
#: Images that are wider than this are put one above the other.
WIDE = 1.8
#: The parts of the matches, their names in the legend and their colours, from the lowest to the highest.
_PARTS = (
    ("tracks", "tracks, no motion estimated", TRACK),
    ("outliers", "outliers of the window", OUTLIER),
    ("inliers", "inliers of the window", INLIER),
    ("moving", "moving objects", MOVING),
)
#: Longest track that is plotted from one shown frame to the next, as a share of the width of the image.
_LONGEST_TAIL = 0.15


def draw_frame(
    axes: Axes, shown: ShownFrame, before: ShownFrame | None, width: int, landmarks: Bools | None = None
) -> None:
    """Draw a frame, its tracks, and how the tracks moved since an earlier frame: ``landmarks`` (N,)."""
    from matplotlib.collections import LineCollection

    _image(axes, bgr(shown.image)[..., ::-1])
    axes.set_title(f"frame {shown.index}", fontsize=9, color=FAINT, pad=3)
    scale = shown.image.shape[1] / width
    places = _shown(shown.pixels, scale)
    if before is not None:
        _, i, j = np.intersect1d(before.track_ids, shown.track_ids, return_indices=True)
        # A longer one is no path of a point: descriptors linked the frames, as photographs and after a cut.
        flowed = np.linalg.norm(shown.pixels[j] - before.pixels[i], axis=1) <= _LONGEST_TAIL * width
        tails = np.stack([_shown(before.pixels[i[flowed]], scale), places[j[flowed]]], axis=1)
        axes.add_collection(LineCollection(list(tails), colors=TRACK, linewidths=0.6, alpha=0.7), autolim=False)
    chosen = np.zeros(len(places), bool) if landmarks is None else landmarks
    for part, color in ((places[~chosen], TRACK), (places[chosen], INLIER)):
        axes.plot(part[:, 0], part[:, 1], ".", color=color, markersize=3.0, markeredgewidth=0)


def draw_pair(axes: Axes, pair: ShownPair, width: int) -> None:
    """Draw two images side by side with their matches; wide images one above the other."""
    from matplotlib.collections import LineCollection

    attempt = pair[2]
    first, second = (bgr(image)[..., ::-1] for image in pair[:2])
    height, wide = first.shape[0], first.shape[1] > WIDE * first.shape[0]
    gap = np.full((4, first.shape[1], 3) if wide else (height, 4, 3), 255, np.uint8)
    _image(axes, np.concatenate([first, gap, second], axis=0 if wide else 1))
    offset = np.array((0, height + 4) if wide else (first.shape[1] + 4, 0), float)
    scale = first.shape[1] / width
    ends = np.stack([_shown(attempt.pixels1, scale), _shown(attempt.pixels2, scale) + offset], axis=1)
    sparse = np.arange(len(ends)) % max(1, -(-len(ends) // _MOST_LINES)) == 0
    parts = match_parts(attempt)
    for name, label, color in _PARTS:
        chosen = parts[name]
        if chosen.any():
            lines = LineCollection(list(ends[chosen & sparse]), colors=color, linewidths=0.6, alpha=0.8)
            axes.add_collection(lines, autolim=False)
            label = f"{label}: {np.count_nonzero(chosen)}"
            axes.plot(*ends[chosen].reshape(-1, 2).T, ".", color=color, markersize=2.2, markeredgewidth=0, label=label)
    axes.set_title("the pair: frames {} and {}".format(*attempt.frames[:2]), loc="left", color=INK, weight="bold")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.01), ncol=3, fontsize=9, markerscale=5, borderpad=0.2)


def _shown(pixels: Floats, scale: float) -> Floats:
    """Pixels of the image as it was read -> pixels of its small copy, both with centres at integers."""
    return (pixels + 0.5) * scale - 0.5


def _image(axes: Axes, rgb: Image) -> None:
    axes.imshow(rgb, interpolation="bilinear")
    axes.autoscale(False)
    axes.axis("off")


# -- the decision: the risk of each attempt, its terms, its bound, and what held it ----------------


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
        words = "no risk was stated: no motion was estimated, or the method states none"
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


# -- maps, seen along one of the axes of their world -----------------------------------------------


#: The views by their names: the axes of the world frame (x right, y down, z forward) that point to the right and
#: upwards in the picture, and the sign of the latter.
ABOVE, SIDE, BEHIND = "from above", "from the side", "from behind the first camera"
_VIEWS = {ABOVE: (0, 2, 1.0), SIDE: (2, 1, -1.0), BEHIND: (0, 1, -1.0)}
#: The share of the landmarks that decides the extent: a few far ones would make the rest small.
_QUANTILES = (0.01, 0.99)
#: Depth of a frustum as a share of the extent of the view.
_FRUSTUM = 0.05
#: Margin around the content as a share of its size.
_MARGIN = 0.06
#: Largest number of frusta; more cover one another.
_MOST_FRUSTA = 12


def widest_view(map_: InitialMap) -> str:
    """Choose the view along the axis in which the landmarks spread least: a plane is never seen edge-on."""
    low, high = np.quantile(map_.points, _QUANTILES, axis=0)
    return max(_VIEWS, key=lambda name: float(np.prod((high - low)[list(_VIEWS[name][:2])])))


def draw_map(axes: Axes, map_: InitialMap, view: str, title: str, truth: Floats | None = None) -> None:
    """Draw the landmarks, the path and cameras along it: ``truth`` (N, 3) is the true path."""
    from matplotlib.collections import LineCollection

    right, up, sign = _VIEWS[view]

    def seen(points: Floats) -> Floats:
        return points[..., (right, up)] * (1.0, sign)

    x, y = seen(map_.points).T
    axes.scatter(x, y, s=8, c=map_.colors / 255.0, linewidths=0, alpha=0.95)
    _draw_path(axes, map_, view, truth)
    # The content in the middle, with equal scales in both directions; matplotlib's own may cut it.
    low, high = (seen(corner) for corner in _extent(map_))
    box, middle, size = axes.get_window_extent(), (low + high) / 2, np.abs(high - low)
    scale = (1 + 2 * _MARGIN) * max(size[0] / box.width, size[1] / box.height, 1e-9)
    axes.set_xlim(middle[0] - scale * box.width / 2, middle[0] + scale * box.width / 2)
    axes.set_ylim(middle[1] - scale * box.height / 2, middle[1] + scale * box.height / 2)

    camera, depth = map_.camera, _FRUSTUM * float(size.max())
    half = np.array([camera.width / camera.fx, camera.height / camera.fy, 2.0]) * depth / 2
    corners = half * [[1, 1, 1], [1, -1, 1], [-1, -1, 1], [-1, 1, 1]]
    outline = np.array([[a, b] for k, a in enumerate(corners) for b in (np.zeros(3), corners[k - 1])])
    shown = map_.keyframes[:: max(1, -(-len(map_.keyframes) // _MOST_FRUSTA))]
    lines = [line for keyframe in shown for line in seen(keyframe.world_from_cam.apply(outline))]
    axes.add_collection(LineCollection(lines, colors=ESTIMATE, linewidths=0.9), autolim=False)

    axes.set_facecolor(GROUND)
    axes.set_title(title, loc="left", color=INK, fontsize=9.5, pad=4)
    axes.tick_params(labelsize=8, colors=FAINT, length=0)
    axes.grid(color=FAINT, alpha=0.25, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[:].set_visible(False)
    axes.set_xlabel("median depths" if map_.scale is None else "metres", fontsize=8, color=FAINT, labelpad=1)


def draw_cameras(axes: Axes, map_: InitialMap, view: str, truth: Floats | None = None) -> None:
    """Draw the path of the cameras alone, since it is often short beside the depth of the scene."""
    _draw_path(axes, map_, view, truth)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    axes.set_facecolor(GROUND)
    axes.set_title("the cameras alone", loc="left", color="white", fontsize=9, pad=3)
    axes.tick_params(labelsize=7, colors=FAINT, length=0)
    axes.locator_params(nbins=4)
    axes.spines[:].set_color(FAINT)
    axes.legend(loc="best", fontsize=8, labelcolor="white")


def _draw_path(axes: Axes, map_: InitialMap, view: str, truth: Floats | None) -> None:
    right, up, sign = _VIEWS[view]
    path = np.array([keyframe.world_from_cam.t for keyframe in map_.keyframes])
    if truth is not None and len(truth) > 1:
        axes.plot(truth[:, right], sign * truth[:, up], "--", color=TRUTH, linewidth=2.2, label="ground truth")
    axes.plot(path[:, right], sign * path[:, up], ".-", color=ESTIMATE, linewidth=1.4, markersize=5, label="estimate")


def _extent(map_: InitialMap) -> tuple[Floats, Floats]:
    """The least and the largest coordinates (3,) of nearly all landmarks and of the cameras."""
    near, far = np.quantile(map_.points, _QUANTILES, axis=0)
    path = [keyframe.world_from_cam.t for keyframe in map_.keyframes]
    return np.min([near, *path], axis=0), np.max([far, *path], axis=0)
