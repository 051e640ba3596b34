"""``overview.png``: what a run saw, what it decided and why, in one image.

It is drawn with matplotlib on its bundled fonts, without a display. All figures come from the result and its summary.
During the run a :class:`StoryRecorder` keeps what is shown beside them: a few frames with their tracks, and the last
pair. The same run gives the same bytes with the same version of matplotlib.
"""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slam_init.errors import plain_line
from slam_init.evaluation.metrics import true_path
from slam_init.output.summary import Summary
from slam_init.recording.images import RecentImages, bgr
from slam_init.recording.map_view import round_length
from slam_init.recording.pair_view import moving_matches
from slam_init.recording.recorder import Recorder
from slam_init.recording.text import headline
from slam_init.types.arrays import Bools, Floats, Image, Ints, evenly_spaced
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Trajectory
from slam_init.types.refusal import Direction, Gate, GateName, Verdict, in_words
from slam_init.types.result import Attempt, Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Left, bottom, width and height as shares.
Box = tuple[float, float, float, float]

_WIDTH_PX, _HEIGHT_PX = 1600, 1000
#: The parts, from the top: title, frames, pair and map, decision.
_TITLE: Box = (0.02, 0.89, 0.96, 0.09)
_FRAMES: Box = (0.02, 0.675, 0.96, 0.185)
_PAIR: Box = (0.02, 0.315, 0.44, 0.315)
_MAP: Box = (0.48, 0.315, 0.50, 0.315)
_DECISION: Box = (0.055, 0.055, 0.765, 0.185)
#: Width of the legend beside the strip of frames.
_LEGEND = 0.135
#: Most maps of a run that started anew; each has a row.
_MOST_SEGMENTS = 4
#: Most frames in the strip; fewer where images are wide.
_MOST_FRAMES = 6
#: More lines between the images of a pair cannot be told apart.
_MOST_LINES = 90
#: Images that are wider than this are put one above the other.
_WIDE = 1.8
#: Longest track that is drawn from one shown frame to the next, as a share of the width of the image.
LONGEST_TAIL = 0.15
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
#: The axes of the world frame (x right, y down, z forward) that point to the right and upwards in the picture, and the
#: sign of the latter.
ABOVE, SIDE = "above", "the side"
_AXES = {ABOVE: (0, 2, 1.0), SIDE: (2, 1, -1.0)}
#: The share of the landmarks that decides the extent: a few far ones would make the rest small.
_QUANTILES = (0.01, 0.99)
#: Size of a frustum as a share of the extent of the view.
_FRUSTUM, _FRUSTUM_OF_PATH = 0.07, 0.16
#: Margin around the content as a share of its size, and room for the scale bar as a share of the height of the view.
_MARGIN, _BAR_ROOM = 0.06, 0.14
#: Largest number of frusta; more cover one another.
_MOST_FRUSTA = 12
#: The colours of matches and paths are those of the recording.
INLIER, OUTLIER, MOVING, TRACK = "#2fb45a", "#e64646", "#b478e6", "#ffc828"
ESTIMATE, TRUTH = "#3ca0ff", "#ff9628"
INK, PAPER, FAINT, _GROUND = "#1c2430", "#ffffff", "#6b7685", "#11161d"
#: One colour for what holds the decision: no motion blue, no scene brown, no common motion purple, flat orange, unknown
#: lens yellow, the map pink, accepted green.
VERDICT_COLORS: dict[Verdict, str] = {
    Verdict.STATIC_CAMERA: "#7d8fa3",
    Verdict.PURE_ROTATION: "#4f7cac",
    Verdict.LOW_PARALLAX: "#2aa3cf",
    Verdict.TOO_FEW_FEATURES: "#a98467",
    Verdict.TOO_FEW_MATCHES: "#7f5539",
    Verdict.NO_CONSISTENT_MOTION: "#8e44ad",
    Verdict.MOVING_BODIES: "#b478e6",
    Verdict.AMBIGUOUS_PLANE: "#f28c28",
    Verdict.UNKNOWN_FOCAL_LENGTH: "#b8a200",
    Verdict.WRONG_FOCAL_LENGTH: "#6b5900",
    Verdict.EXTERNAL_METHOD: "#566573",
    Verdict.TOO_FEW_LANDMARKS: "#d9749f",
    Verdict.BUNDLE_ADJUSTMENT_FAILED: "#c2185b",
    Verdict.TOO_FEW_FRAMES: "#777777",
    Verdict.ACCEPTED: INLIER,
}
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


# -- the story of a run ----------------------------------------------------------------------------


#: Largest number of frames in memory besides the recent images. Where there are more, every second one is dropped, so
#: that those that are left are evenly spaced over a run of any length.
_MOST_KEPT = 16


@dataclass(frozen=True, eq=False)
class ShownFrame:
    """A frame with its tracks."""

    #: Absolute index of the frame.
    index: int
    #: (h, w) A small copy of the image.
    image: Image
    #: (N,) Strictly increasing.
    track_ids: Ints
    #: (N, 2) Positions of the tracks in the image as it was read.
    pixels: Floats


@dataclass(frozen=True, eq=False)
class ShownPair:
    """Two images and their matches."""

    #: (h, w) Small copies of the images.
    images: tuple[Image, Image]
    #: With the matches, in pixels of the images as they were read.
    attempt: Attempt


@dataclass(frozen=True, eq=False)
class Story:
    """What a picture shows beside the result."""

    #: In time order: keyframes of an accepted map, else frames that are evenly spaced over the run.
    frames: tuple[ShownFrame, ...] = ()
    #: The last pair that was tried; where no pair was estimated, the first and the last frame with their common
    #: tracks. None without two frames.
    pair: ShownPair | None = None


class StoryRecorder(Recorder):
    """Keeps the story of a run, in bounded memory.

    * ``images``: Small copies of the last images, where another recorder keeps them too.
    """

    def __init__(self, images: RecentImages | None = None) -> None:
        self._images = images or RecentImages()
        #: Every so many of the frames that were seen.
        self._spaced: list[ShownFrame] = []
        self._step, self._seen = 1, 0
        self._last: ShownFrame | None = None
        self._pair: ShownPair | None = None
        self._keyframes: tuple[ShownFrame, ...] = ()
        self._ended = False

    def restarted(self) -> None:
        """End the story with its map: what follows belongs to another one."""
        self._ended = bool(self._keyframes)

    def frame(self, frame: Frame, observations: Observations) -> None:
        """Keep the frame, if it is one of those that are evenly spaced."""
        if self._keyframes:  # the story ends with the map
            return
        self._images.add(frame)
        self._last = shown = self._shown(observations)
        if shown is not None and self._seen % self._step == 0:
            if len(self._spaced) == _MOST_KEPT:
                self._spaced, self._step = self._spaced[::2], 2 * self._step
            self._spaced.append(shown)
        self._seen += 1

    def attempt(self, attempt: Attempt) -> None:
        """Keep the pair of an attempt that has matches."""
        if self._ended or not len(attempt.pixels1) or len(attempt.frames) < 2:
            return
        first, second = (self._images.get(index) for index in attempt.frames[:2])
        if first is not None and second is not None:
            self._pair = ShownPair((first, second), attempt)

    def initialized(self, map_: InitialMap, observations: Sequence[Observations]) -> None:
        """Keep the keyframes of the accepted map."""
        if self._keyframes:  # those of the first map, which the picture shows
            return
        chosen = [observations[k] for k in evenly_spaced(len(observations), _MOST_KEPT)]
        self._keyframes = tuple(shown for seen in chosen if (shown := self._shown(seen)) is not None)

    def story(self) -> Story:
        """Return what was kept."""
        frames = self._keyframes or tuple(self._spaced)
        if not self._keyframes and self._last is not None and frames[-1].index != self._last.index:
            frames = (*frames, self._last)
        return Story(frames, self._pair or _first_and_last(frames))

    def _shown(self, observations: Observations) -> ShownFrame | None:
        image = self._images.get(observations.frame)
        if image is None:
            return None
        return ShownFrame(observations.frame, image, observations.track_ids, observations.pixels)


def _first_and_last(frames: Sequence[ShownFrame]) -> ShownPair | None:
    """The first and the last frame with the tracks that both see, as an attempt without evidence."""
    if len(frames) < 2:
        return None
    first, last = frames[0], frames[-1]
    _, i, j = np.intersect1d(first.track_ids, last.track_ids, return_indices=True)
    indices, none = (first.index, last.index), np.zeros(len(i), bool)
    tracks = Attempt(
        indices, Verdict.TOO_FEW_MATCHES, pixels1=first.pixels[i], pixels2=last.pixels[j], inliers=none, moving=none
    )
    return ShownPair((first.image, last.image), tracks)


# -- the picture -----------------------------------------------------------------------------------


def overview_png(result: Result, summary: Summary, story: Story, truth: Trajectory | None = None) -> bytes:
    """Draw the overview of a run.

    * ``truth``: The true trajectory; it is drawn beside the path of an accepted map.
    * Returns: A PNG file of 1600 x 1000 pixels. Equal arguments give equal bytes with the same version of matplotlib.
    """
    import cv2

    with canvas(_WIDTH_PX, _HEIGHT_PX) as figure:
        _draw_title(_blank(figure, _TITLE), result, summary)
        _draw_frames(figure, result, summary, story)
        if story.pair is not None:
            draw_pair(figure.add_axes(_PAIR), story.pair, summary.camera.width)
        if len(result.segments) > 1:
            _draw_segments(figure, result)
        elif result.map is not None:
            _draw_map(figure, result.map, truth)
        elif len(result.hypotheses) == 2:
            _draw_conjugate_maps(figure, result)
        else:
            _draw_reason(_blank(figure, _MAP), result)
        draw_decision(figure.add_axes(_DECISION), result.attempts)
        image = np.ascontiguousarray(pixels_of(figure)[..., ::-1])
    # Without any metadata, equal pictures are equal bytes. Other strategies take half as long again, and the file is
    # hardly smaller: images have noise.
    _, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE])
    return encoded.tobytes()


def _blank(figure: Figure, box: Box) -> Axes:
    """Axes for text alone."""
    axes = figure.add_axes(box)
    axes.axis("off")
    return axes


def _draw_title(axes: Axes, result: Result, summary: Summary) -> None:
    """The verdict in words, the figures of the map, and what was run."""
    color = VERDICT_COLORS[result.reason or Verdict.ACCEPTED]
    axes.plot([0.0, 0.0], [0.0, 1.0], color=color, linewidth=10, transform=axes.transAxes, clip_on=False)
    write(axes, 0.012, 1.02, headline(summary), 25, INK, "bold")
    wrong, is_map = result.wrong_focal, result.map is not None
    if wrong is None or is_map:
        write(axes, 0.012, 0.47, wrapped(_subtitle(result), 150, 1), 13, INK)
    if wrong is not None:  # beside the short title of a map, and below the long one of a refusal
        write(axes, *((0.5, 0.9) if is_map else (0.012, 0.4)), wrapped(wrong.note, 100, 1), 11.5, OUTLIER, "bold")
    origin = f"source {summary.source.name}, method {summary.method}, seed {summary.seed}"
    write(axes, 0.012, 0.17, wrapped(origin, 190, 1), 9.5, FAINT)


def _subtitle(result: Result) -> str:
    if len(result.segments) > 1:
        begun = "a new one was begun where the one before was lost"
        return f"{len(result.segments)} maps: {begun}. Frames, pair and risk are those of the first."
    if result.hypotheses and result.map is None:
        return "Two maps explain the views, and one of them is right. Both are kept until further views decide."
    last = result.attempts[-1] if result.attempts else None
    if result.map is None:
        # What a map has to have before it is handed over, and this run had not.
        failed = [] if last is None else [gate.name for gate in last.failed_gates]
        missing = "no map is handed over before its risk is small enough"
        if failed and GateName.RISK not in failed:
            missing = "a map is handed over once its risk and all other conditions are met"
        return f"attempts: {len(result.attempts)}; {missing}."
    map_ = result.map
    risk = [] if last is None or last.window is None else [f"risk {last.window.risk:.2g} that the map is wrong"]
    facts = (
        *risk,
        f"{len(map_.keyframes)} keyframes",
        f"{len(map_.points)} landmarks, {map_.scene} scene",
        f"parallax {map_.median_parallax_deg:.2f} deg",
        f"reprojection {map_.reprojection_rmse_px:.2f} px",
    )
    return "  |  ".join(facts)


def _draw_frames(figure: Figure, result: Result, summary: Summary, story: Story) -> None:
    """The strip of frames: as many as fit beside one another."""
    left, bottom, width, height = _FRAMES
    if not story.frames:
        write(_blank(figure, _FRAMES), 0.0, 0.6, "no frame was read", 12, FAINT)
        return
    camera = summary.camera
    each = height * _HEIGHT_PX / _WIDTH_PX * camera.width / camera.height
    strip = width - _LEGEND
    most = int(np.clip(strip / each, 1, _MOST_FRAMES))
    chosen = [story.frames[k] for k in evenly_spaced(len(story.frames), most)]
    gap = 0.008
    each = min(each, (strip + gap) / len(chosen) - gap)
    words = "yellow: tracks, and how\nthey moved since the\nframe on the left"
    if result.map is not None:
        words += "\n\ngreen: landmarks of the map"
    for k, shown in enumerate(chosen):
        axes = figure.add_axes((left + k * (each + gap), bottom, each, height))
        known = None if result.map is None else np.isin(shown.track_ids, result.map.track_ids)
        draw_frame(axes, shown, chosen[k - 1] if k else None, camera.width, known)
    legend = _blank(figure, (left + len(chosen) * (each + gap) + 0.004, bottom, _LEGEND, height))
    write(legend, 0.0, 0.95, words, 9.5, FAINT)


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
        flowed = np.linalg.norm(shown.pixels[j] - before.pixels[i], axis=1) <= LONGEST_TAIL * width
        tails = np.stack([_shown(before.pixels[i[flowed]], scale), places[j[flowed]]], axis=1)
        axes.add_collection(LineCollection(list(tails), colors=TRACK, linewidths=0.6, alpha=0.7), autolim=False)
    chosen = np.zeros(len(places), bool) if landmarks is None else landmarks
    for part, color in ((places[~chosen], TRACK), (places[chosen], INLIER)):
        axes.plot(part[:, 0], part[:, 1], ".", color=color, markersize=3.0, markeredgewidth=0)


def draw_pair(axes: Axes, pair: ShownPair, width: int) -> None:
    """Draw two images side by side with their matches; wide images one above the other."""
    from matplotlib.collections import LineCollection

    attempt = pair.attempt
    first, second = (bgr(image)[..., ::-1] for image in pair.images)
    height, wide = first.shape[0], first.shape[1] > _WIDE * first.shape[0]
    gap = np.full((4, first.shape[1], 3) if wide else (height, 4, 3), 255, np.uint8)
    _image(axes, np.concatenate([first, gap, second], axis=0 if wide else 1))
    offset = np.array((0, height + 4) if wide else (first.shape[1] + 4, 0), float)
    scale = first.shape[1] / width
    ends = np.stack([_shown(attempt.pixels1, scale), _shown(attempt.pixels2, scale) + offset], axis=1)
    drawn = np.arange(len(ends)) % max(1, -(-len(ends) // _MOST_LINES)) == 0
    moving = moving_matches(attempt)
    others = ~attempt.inliers & ~moving
    parts = [("moving bodies", moving, MOVING)]
    if attempt.judged:
        parts = [("outliers", others, OUTLIER), ("inliers", attempt.inliers, INLIER), *parts]
    else:
        parts = [("tracks, no motion estimated", others, TRACK), *parts]
    for name, chosen, color in parts:
        if chosen.any() or name == "inliers":
            lines = LineCollection(list(ends[chosen & drawn]), colors=color, linewidths=0.6, alpha=0.8)
            axes.add_collection(lines, autolim=False)
            x, y = ends[chosen].reshape(-1, 2).T
            label = f"{name}: {np.count_nonzero(chosen)}"
            axes.plot(x, y, ".", color=color, markersize=2.2, markeredgewidth=0, label=label)
    title = f"the pair: frames {attempt.frames[0]} and {attempt.frames[1]}"
    axes.set_title(title, loc="left", color=INK, weight="bold")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.01), ncol=3, fontsize=9, markerscale=5, borderpad=0.2)


def _shown(pixels: Floats, scale: float) -> Floats:
    """Pixels of the image as it was read -> pixels of its small copy, both with centres at integers."""
    return (pixels + 0.5) * scale - 0.5


def _image(axes: Axes, rgb: Image) -> None:
    axes.imshow(rgb, interpolation="bilinear")
    axes.autoscale(False)
    _hide_border(axes)


def _hide_border(axes: Axes) -> None:
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def _draw_map(figure: Figure, map_: InitialMap, truth: Trajectory | None) -> None:
    """The map from above and from the side, and its cameras alone."""
    path = true_path(map_.keyframes, truth)
    left, bottom, width, height = _MAP
    gap = 0.01
    large = 0.36 * width
    above = _draw_both(figure, map_, (left, bottom, large, height), gap, ("the map from above", "from the side"), path)
    x, beside = left + 2 * (large + gap), width - 2 * large - 2 * gap
    for view, low, share in ((ABOVE, bottom + 0.52 * height, 0.48), (SIDE, bottom, 0.40)):
        axes = figure.add_axes((x, low, beside, share * height))
        title = f"the {len(map_.keyframes)} cameras, from {view}"
        draw_map(axes, map_, view, title, path, cameras_alone=True)
    above.legend(loc="upper left", bbox_to_anchor=(-0.02, -0.005), ncol=2, fontsize=9, borderpad=0)


def _draw_both(
    figure: Figure, map_: InitialMap, box: Box, gap: float, titles: tuple[str, str], truth: Floats | None = None
) -> Axes:
    """Draw a map from above into a box, and from the side into an equal one beside it; return the first axes."""
    left, bottom, width, height = box
    above = figure.add_axes(box)
    draw_map(above, map_, ABOVE, titles[0], truth)
    draw_map(figure.add_axes((left + width + gap, bottom, width, height)), map_, SIDE, titles[1], truth)
    return above


def _draw_segments(figure: Figure, result: Result) -> None:
    """The maps of a run that started anew, a row for each: from above, from the side, and in words."""
    left, bottom, width, height = _MAP
    shown = result.segments[:_MOST_SEGMENTS]
    gap = 0.02
    each = (height + gap) / len(shown) - gap
    large = 0.3 * width
    for k, segment in enumerate(shown):
        low = bottom + height - (k + 1) * each - k * gap
        titles = (f"map {k + 1} from above", "from the side")
        _draw_both(figure, segment.map, (left, low, large, each), 0.01, titles)
        frames = segment.map.keyframes
        facts = [
            f"frames {frames[0].frame} to {frames[-1].frame}, {len(segment.map.points)} landmarks",
            f"{len(segment.located)} further frames located",
            "followed to the end" if segment.lost_at is None else f"lost at frame {segment.lost_at}",
        ]
        if k == len(shown) - 1 and len(result.segments) > len(shown):
            facts.append(f"further maps: {len(result.segments) - len(shown)}")
        box = _blank(figure, (left + 2 * (large + 0.01), low, width - 2 * (large + 0.01), each))
        write(box, 0.02, 0.95, "\n".join(facts), 10.5, INK)


def _draw_conjugate_maps(figure: Figure, result: Result) -> None:
    """Both undecided maps, side by side, and what has to decide between them."""
    left, bottom, width, height = _MAP
    gap = 0.012
    each = (width - gap) / 2
    half = (each - 0.004) / 2
    for k, (map_, name) in enumerate(zip(result.hypotheses, "AB", strict=True)):
        titles = (f"map {name} from above", f"map {name} from the side")
        _draw_both(figure, map_, (left + k * (each + gap), bottom, half, height), 0.004, titles)
    box = _blank(figure, (left, bottom - 0.045, width, 0.04))
    color = VERDICT_COLORS[result.reason or Verdict.AMBIGUOUS_PLANE]
    write(box, 0.0, 1.0, wrapped(_deciding(result), 85, 2), 11, color, "bold")


def _deciding(result: Result) -> str:
    """The evidence that has to decide between two maps: their vote, and the risk by another motion."""
    if result.reason == Verdict.MOVING_BODIES:
        return "The tracks of A are at rest and those of B move, or the other way round."
    facts = [] if result.margin is None else [f"The tracks {result.margin.in_words('A', 'B')}."]
    last = next((one for one in reversed(result.attempts) if one.window is not None), None)
    if last is not None and last.window is not None:
        bound = next((f" (bound {gate.threshold:g})" for gate in last.gates if gate.name is GateName.RISK), "")
        facts.append(f"The risk that it is B is {last.window.risk_rival:.2g}{bound}.")
    return " ".join(facts)


def _draw_reason(axes: Axes, result: Result) -> None:
    """Why there is no map: the advice in large letters, and the condition that failed."""
    reason = result.reason or Verdict.TOO_FEW_FRAMES
    said, _, advice = (result.advice or reason.advice).partition(": ")
    write(axes, 0.03, 0.97, wrapped(said[:1].upper() + said[1:], 52, 2), 17, INK)
    lines = wrapped((advice or said)[:1].upper() + (advice or said)[1:], 26, 3)
    write(axes, 0.03, 0.73, lines, 31, VERDICT_COLORS[reason], "bold")
    refused = (one for one in reversed(result.attempts) if one.verdict == reason and len(one.frames) > 1)
    last = next((one for one in refused if one.failed_gates), None)
    if last is not None:
        frames = f"frames {last.frames[0]} and {last.frames[1]}"
        facts = [f"{frames}: {gate_words(gate)}" for gate in last.failed_gates[:2]]
        write(axes, 0.03, 0.12, "\n".join(["what held it last", *facts]), 11, FAINT)


def gate_words(gate: Gate) -> str:
    """Write what a gate compares."""
    unit = f" {gate.unit}" if gate.unit else ""
    name = str(gate.name).removesuffix(f"_{gate.unit}").replace("_", " ")
    side = "at least" if gate.direction is Direction.AT_LEAST else "at most"
    return f"{name} {gate.value:.3g}{unit}, needs {side} {gate.threshold:.3g}{unit}"


def draw_map(
    axes: Axes, map_: InitialMap, view: str, title: str, truth: Floats | None = None, *, cameras_alone: bool = False
) -> None:
    """Draw the landmarks, the path, the first and the last camera, and a scale bar: ``truth`` (N, 3).

    * ``cameras_alone``: Draw the cameras as large as they fit: a path is often short beside the depth of the scene.
    """
    from matplotlib.collections import PolyCollection

    right, up, sign = _AXES[view]
    path = np.array([keyframe.world_from_cam.t for keyframe in map_.keyframes])
    low, high = path.min(axis=0), path.max(axis=0)
    if cameras_alone:
        size = _FRUSTUM_OF_PATH * (float(np.linalg.norm(high - low)) or 1e-3)
        low, high = low - 1.2 * size, high + 1.2 * size
        shown = map_.keyframes[:: max(1, -(-len(path) // _MOST_FRUSTA))]
    else:
        x, y = map_.points[:, right], sign * map_.points[:, up]
        axes.scatter(x, y, s=5, c=map_.colors / 255.0, linewidths=0, alpha=0.95, rasterized=True)
        near, far = np.quantile(map_.points, _QUANTILES, axis=0)
        low, high = np.minimum(near, low), np.maximum(far, high)
        size = _FRUSTUM * float(max(high[right] - low[right], high[up] - low[up]))
        shown = (map_.keyframes[0], map_.keyframes[-1])
    _frame(axes, low, high, view, title)
    if truth is not None and len(truth) > 1:
        x, y = truth[:, right], sign * truth[:, up]
        axes.plot(x, y, "--", color=TRUTH, linewidth=2.2, label="ground truth", zorder=3)
    axes.plot(path[:, right], sign * path[:, up], "-", color=ESTIMATE, linewidth=1.4, label="cameras", zorder=4)
    camera = map_.camera
    corners = np.array([[x, y, 1.0] for x in (-1, 1) for y in (-1, 1)])
    corners *= (size * camera.width / (2 * camera.fx), size * camera.height / (2 * camera.fy), size)
    # The outline of a frustum, seen along an axis: the apex, and the middles of the sides to the left and right, or
    # above and below.
    sides = (corners[:2], corners[2:]) if view == ABOVE else (corners[::2], corners[1::2])
    outline = np.array([np.zeros(3), *(side.mean(axis=0) for side in sides)])
    seen = [keyframe.world_from_cam.apply(outline)[:, (right, up)] * (1.0, sign) for keyframe in shown]
    frusta = PolyCollection(seen, facecolors="none", edgecolors=ESTIMATE, linewidths=1.2, zorder=5)
    axes.add_collection(frusta, autolim=False)
    _draw_scale_bar(axes, map_)


def _frame(axes: Axes, low: Floats, high: Floats, view: str, title: str) -> None:
    """Set the extent of a dark view with equal scales in both directions: the content, over room for the scale bar."""
    right, up, sign = _AXES[view]
    left, width = low[right], max(high[right] - low[right], 1e-9)
    below, above = sorted((sign * low[up], sign * high[up]))
    height = max(above - below, 1e-9)
    # Matplotlib's own equal scales may cut the content.
    box = axes.get_window_extent()
    scale = (1 + 2 * _MARGIN) * max(width / box.width, height / (box.height * (1 - _BAR_ROOM)))
    middle_x, middle_y = left + width / 2, (below + above - _BAR_ROOM * scale * box.height) / 2
    axes.set_xlim(middle_x - scale * box.width / 2, middle_x + scale * box.width / 2)
    axes.set_ylim(middle_y - scale * box.height / 2, middle_y + scale * box.height / 2)
    axes.set_facecolor(_GROUND)
    axes.set_title(title, loc="left", color=INK, fontsize=9.5, pad=4)
    _hide_border(axes)


def _draw_scale_bar(axes: Axes, map_: InitialMap) -> None:
    """A bar of a round length, a fifth to a half of the width of the view."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    width = right - left
    length = round_length(0.4 * width)
    x, y = left + 0.05 * width, low + 0.07 * (high - low)
    axes.plot([x, x + length], [y, y], "-", color="white", linewidth=2.5, solid_capstyle="butt", zorder=6)
    label = f"{length:g} of the median depth" if map_.scale is None else f"{length:g} m"
    axes.text(x, y + 0.02 * (high - low), label, color="white", fontsize=8, va="bottom", zorder=6)


def draw_decision(axes: Axes, attempts: Sequence[Attempt]) -> None:
    """Draw the risk of each attempt with its terms and the bound, and below them what held the decision."""
    from matplotlib.ticker import MaxNLocator

    axes.set_title("the decision: risk that the map is wrong", loc="left", color=INK, weight="bold")
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
    """A figure of the window of each attempt, NaN where none was judged."""
    return np.array([np.nan if one.window is None else float(getattr(one.window, name)) for one in attempts])


def _draw_terms(axes: Axes, frames: Floats, attempts: Sequence[Attempt]) -> None:
    """The terms that ever exceed the smallest risk that is shown, as thin grey lines."""
    for name, label, dashes in _TERMS:
        values = _risks(attempts, name)
        lines = ~np.isnan(values[1:] + values[:-1])  # a single value makes no line
        if lines.any() and np.nanmax(values) > _LEAST_RISK:
            shown = np.clip(values, _LEAST_RISK, 1.0)
            axes.plot(frames, shown, linestyle=dashes, color=FAINT, linewidth=1.0, label=f"part of it: {label}")


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
    axes.scatter(frames, shown, s=size**2, c=colors, linewidths=0, zorder=3)
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
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(1.0, -0.12), title="what held it", alignment="left")


@contextmanager
def canvas(width_px: int, height_px: int) -> Iterator[Figure]:
    """Make an empty figure, with matplotlib's own defaults instead of those of the user.

    * Returns: It has to be drawn in the ``with`` block.
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
            # A name may have letters that the font lacks: they are drawn as boxes.
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


def write(axes: Axes, x: float, y: float, text: str, size: float, color: str = INK, weight: str = "normal") -> None:
    """Write a text at the left top of a place in axes that are otherwise empty."""
    place = axes.transAxes
    axes.text(x, y, text, transform=place, fontsize=size, color=color, weight=weight, va="top", parse_math=False)


def wrapped(text: str, columns: int, most_lines: int = 4) -> str:
    """Break a text of one line into several."""
    return "\n".join(textwrap.wrap(plain_line(text), columns, max_lines=most_lines, placeholder=" ..."))
