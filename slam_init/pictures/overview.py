"""``overview.png``: what a run saw, what it decided and why, in one image.

It is plotted with matplotlib on its bundled fonts, without a display. All figures come from the result and its summary.
A :class:`~slam_init.recording.recorder.StoryRecorder` keeps during the run what is shown beside them. The same run
gives the same bytes with the same version of matplotlib.

The head states the verdict, the figures of the map and every note. Below it stand on the left the frames, the pair and
the decision. The right half holds the map; without one it holds the gate that refused.
"""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slam_init.errors import plain_line
from slam_init.evaluation.metrics import true_path
from slam_init.output.summary import Summary
from slam_init.recording.recorder import ShownFrame, ShownPair, StoryRecorder, bgr, match_parts
from slam_init.recording.text import headline
from slam_init.types.arrays import Bools, Floats, Image, evenly_spaced
from slam_init.types.initial_map import InitialMap, risk_in_words
from slam_init.types.pose import Trajectory
from slam_init.types.refusal import Direction, Gate, GateName, Verdict, in_words
from slam_init.types.result import Attempt, Result, Segment

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH, _HEIGHT = 1600, 1000
#: Left ends and widths of the column of the frames and of the map.
_LEFT, _LEFT_WIDTH, _RIGHT, _RIGHT_WIDTH = 30, 590, 670, 910
#: Bottom of both.
_BOTTOM = 960
#: Most frames beside one another, and their largest height.
_MOST_FRAMES, _FRAME_HEIGHT = 3, 150
#: Largest height of the decision.
_DECISION_HEIGHT = 420
#: Room for the title of a map and for the axis of the one above it.
_TITLE = 72
#: Most maps of a run that restarted.
_MOST_SEGMENTS = 4
#: Most lines of notes in the head.
_MOST_NOTES = 12


class _Place(NamedTuple):
    """A part of the picture, in pixels from the left top."""

    left: float
    top: float
    width: float
    height: float


def overview_png(result: Result, summary: Summary, story: StoryRecorder, truth: Trajectory | None = None) -> bytes:
    """Draw the overview of a run.

    * ``truth``: The true trajectory; it is plotted beside the path of an accepted map.
    * Returns: A PNG file of 1600 x 1000 pixels. Equal arguments give equal bytes with the same version of matplotlib.
    """
    import cv2

    with canvas(_WIDTH, _HEIGHT) as figure:
        top = _draw_head(figure, result, summary) + 40
        _draw_column(figure, top, result, summary, story)
        right = _Place(_RIGHT, top, _RIGHT_WIDTH, _BOTTOM - top)
        if len(result.segments) > 1:
            _draw_maps(figure, right, [_of_segment(k, one) for k, one in enumerate(result.segments[:_MOST_SEGMENTS])])
        elif result.map is not None:
            view, path = widest_view(result.map), true_path(result.map.keyframes, truth)
            axes = axes_at(figure, *right)
            draw_map(axes, result.map, view, f"the map {view}", path)
            draw_cameras(axes.inset_axes((0.06, 0.04, 0.24, 0.22)), result.map, view, path)
        elif len(result.hypotheses) == 2:
            _draw_conjugate_maps(figure, right, result)
        else:
            _draw_refusal(figure, right, result)
        image = np.ascontiguousarray(pixels_of(figure)[..., ::-1])
    # Without any metadata, equal pictures are equal bytes. Other strategies take half as long again, and the file is
    # hardly smaller: images have noise.
    _, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE])
    return encoded.tobytes()


# -- the head --------------------------------------------------------------------------------------


def _draw_head(figure: Figure, result: Result, summary: Summary) -> float:
    """Write the verdict, the figures and the notes; return where they end."""
    y, color = 18.0, VERDICT_COLORS[result.reason or Verdict.ACCEPTED]
    page = blank(axes_at(figure, 0, 0, _WIDTH, _HEIGHT))
    origin = f"source {summary.source.name}, method {summary.method}, seed {summary.seed}"
    wrong = None if result.wrong_focal is None else result.wrong_focal.note
    notes = [f"note: {note}" for note in result.notes if note != wrong]
    lines = [(headline(summary), 25.0, INK, "bold"), *((fact, 12.5, INK, "normal") for fact in _facts(result))]
    lines += [] if wrong is None else [(wrong, 11.0, OUTLIER, "bold")]
    lines += [(line, 9.5, FAINT, "normal") for line in (origin, *notes[:_MOST_NOTES])]
    for text, size, ink, weight in lines:
        shown = wrapped(text, int(2350 / size), 2)
        write(page, 46 / _WIDTH, 1 - y / _HEIGHT, shown, size, ink, weight)
        y += 1.75 * size * (1 + shown.count("\n"))
    page.plot([_LEFT / _WIDTH] * 2, [1 - 18 / _HEIGHT, 1 - y / _HEIGHT], color=color, linewidth=8)
    page.set(xlim=(0, 1), ylim=(0, 1))
    return y


def _facts(result: Result) -> list[str]:
    """The figures of a run: of the map, or of the attempts, and of the last evaluated window."""
    map_, window = result.map, _last_window(result.attempts)
    facts = []
    if len(result.segments) > 1:
        facts.append(f"{len(result.segments)} maps, each from where the last was lost; all figures are of the first.")
    elif result.hypotheses and map_ is None:
        facts.append("Two maps explain the views, and one of them is right. Both are kept until further views decide.")
    parts = [f"attempts: {len(result.attempts)}"]
    if map_ is not None:
        parts = [
            f"{len(map_.keyframes)} keyframes",
            f"{len(map_.points)} landmarks, {map_.scene} scene",
            f"parallax {map_.median_parallax_deg:.2f} deg",
            f"reprojection {map_.reprojection_rmse_px:.2f} px",
        ]
    if window is None or window.window is None or result.camera is None:
        return [*facts, "  |  ".join(parts)]
    evidence, stated = window.window, result.camera
    depth_sigma = evidence.depth_sigma if map_ is None else map_.depth_sigma
    risk = evidence.risk if map_ is None else map_.model_risk or evidence.risk
    # Where the tracks contradict a stated focal length, a line of its own says so.
    fitted = f"not stated, fitted {evidence.focal_factor * stated.focal_px:.0f} px +- {evidence.focal_sigma:.1%}"
    focal = fitted if stated.source == "prior" else f"{stated.focal_px:.0f} px ({stated.source})"
    direction = f"+- {evidence.direction_sigma_deg:.2g} deg" if evidence.direction_sigma_deg < 90 else "unknown"
    depths = f"+- {depth_sigma:.1%}" if depth_sigma < 1 else "unknown"
    return [
        *facts,
        "  |  ".join([f"risk {risk_in_words(risk)}", *parts]),
        f"focal length {focal}  |  direction of the baseline {direction}  |  depths {depths}",
    ]


def _last_window(attempts: Sequence[Attempt]) -> Attempt | None:
    """The last attempt whose window was evaluated."""
    return next((one for one in reversed(attempts) if one.window is not None), None)


# -- the column of frames, pair and decision -------------------------------------------------------


def _draw_column(figure: Figure, top: float, result: Result, summary: Summary, story: StoryRecorder) -> None:
    """Draw the frames, the pair below them, and the decision below both."""
    camera, gap = summary.camera, 8
    frames = [story.frames[k] for k in evenly_spaced(len(story.frames), _MOST_FRAMES)] if story.frames else []
    width = (_LEFT_WIDTH + gap) / _MOST_FRAMES - gap
    height = min(width * camera.height / camera.width, _FRAME_HEIGHT)
    for k, shown in enumerate(frames):
        known = None if result.map is None else np.isin(shown.track_ids, result.map.track_ids)
        axes = axes_at(figure, _LEFT + k * (width + gap), top, width, height)
        draw_frame(axes, shown, frames[k - 1] if k else None, camera.width, known)
    words = "yellow: tracks and their motion since the frame on the left"
    words += "; green: landmarks" if result.map is not None else ""
    words = words if frames else "no frame was read"
    write(blank(axes_at(figure, _LEFT, top + height, _LEFT_WIDTH, 20)), 0.0, 0.8, words, 9, FAINT)
    top += height + 50
    if story.pair is not None:
        aspect = camera.width / camera.height
        height = min(_LEFT_WIDTH / (aspect / 2 if aspect > WIDE else 2 * aspect), 0.45 * (_BOTTOM - top))
        draw_pair(axes_at(figure, _LEFT, top, _LEFT_WIDTH, height), story.pair, camera.width)
        top += height + 60
    height = min(_BOTTOM - top, _DECISION_HEIGHT)
    draw_decision(axes_at(figure, _LEFT + 50, top, _LEFT_WIDTH - 210, height), result.attempts)


# -- the maps, or why there is none ----------------------------------------------------------------


def _draw_maps(figure: Figure, place: _Place, maps: Sequence[tuple[InitialMap, str, str]]) -> None:
    """Draw several maps, each with its view and its title, two beside one another."""
    rows = -(-len(maps) // 2)
    width, height = (place.width - 40) / 2, place.height / rows - _TITLE
    for k, (map_, view, title) in enumerate(maps):
        left, top = place.left + k % 2 * (width + 40), place.top + k // 2 * (height + _TITLE)
        draw_map(axes_at(figure, left, top, width, height), map_, view, title)


def _of_segment(number: int, segment: Segment) -> tuple[InitialMap, str, str]:
    """A map of a run that restarted."""
    frames, view = segment.map.keyframes, widest_view(segment.map)
    end = "followed to the end" if segment.lost_at is None else f"lost at frame {segment.lost_at}"
    facts = f"{len(segment.map.points)} landmarks, {len(segment.located)} further frames located, {end}"
    return segment.map, view, f"map {number + 1} {view}: frames {frames[0].frame} to {frames[-1].frame}\n{facts}"


def _draw_conjugate_maps(figure: Figure, place: _Place, result: Result) -> None:
    """Both undecided maps from two sides, and what has to decide between them."""
    maps = [
        (map_, view, f"map {name} {view}")
        for view in (ABOVE, SIDE)
        for map_, name in zip(result.hypotheses, "AB", strict=True)
    ]
    _draw_maps(figure, place._replace(height=place.height - 40), maps)
    box = blank(axes_at(figure, place.left, place.top + place.height - 60, place.width, 60))
    color = VERDICT_COLORS[result.reason or Verdict.AMBIGUOUS_PLANE]
    write(box, 0.0, 1.0, wrapped(_deciding(result), 110, 2), 11, color, "bold")


def _deciding(result: Result) -> str:
    """The evidence that has to decide between two maps: their vote, and the risk by another motion."""
    if result.reason == Verdict.MOVING_OBJECTS:
        return "The tracks of A are at rest and those of B move, or the other way round."
    facts = [] if result.margin is None else [f"The tracks {result.margin.in_words('A', 'B')}."]
    last = _last_window(result.attempts)
    if last is not None and last.window is not None:
        bound = next((f" (bound {gate.threshold:g})" for gate in last.gates if gate.name is GateName.RISK), "")
        facts.append(f"The risk that it is B is {last.window.risk_competing:.2g}{bound}.")
    return " ".join(facts)


def _draw_refusal(figure: Figure, place: _Place, result: Result) -> None:
    """Why there is no map: what to do in large letters, and the gate that refused with what it got and needed."""
    axes, reason = blank(axes_at(figure, *place)), result.reason or Verdict.TOO_FEW_FRAMES
    said, _, advice = (result.advice or reason.advice).partition(": ")
    write(axes, 0.05, 0.97, wrapped(said[:1].upper() + said[1:], 60, 2), 18, INK)
    words = (advice or said)[:1].upper() + (advice or said)[1:]
    write(axes, 0.05, 0.84, wrapped(words, 30, 3), 32, VERDICT_COLORS[reason], "bold")
    # A reason that no gate names, such as a wrong focal length, stands in the advice alone.
    last = next((one for one in reversed(result.attempts) if one.failed_gates and one.verdict == reason), None)
    if last is None:
        return
    name, got, needed = _gate_words(last.failed_gates[0])
    frames = " and ".join(map(str, last.frames[:2]))
    write(axes, 0.05, 0.44, f"the gate that refused, last at frames {frames}: {name}", 14, INK)
    for x, title, value in ((0.05, "got", got), (0.45, "needs", needed)):
        write(axes, x, 0.34, title, 14, FAINT)
        write(axes, x, 0.28, value, 30, OUTLIER if title == "got" else INK, "bold")


def _gate_words(gate: Gate) -> tuple[str, str, str]:
    """Write the name of a gate, what it got and what it needs."""
    unit = f" {gate.unit}" if gate.unit else ""
    name = str(gate.name).removesuffix(f"_{gate.unit}").replace("_", " ")
    side = "at least" if gate.direction is Direction.AT_LEAST else "at most"
    return name, f"{gate.value:.3g}{unit}", f"{side} {gate.threshold:.3g}{unit}"


# -- the ground of a picture: colours, fonts, and where its parts and texts stand ------------------

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
    ("outliers", "outliers", OUTLIER),
    ("inliers", "inliers", INLIER),
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
            x, y = ends[chosen].reshape(-1, 2).T
            label = f"{label}: {np.count_nonzero(chosen)}"
            axes.plot(x, y, ".", color=color, markersize=2.2, markeredgewidth=0, label=label)
    title = f"the pair: frames {attempt.frames[0]} and {attempt.frames[1]}"
    axes.set_title(title, loc="left", color=INK, weight="bold")
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
