"""``overview.png``: what a run saw, what it decided and why, in one image.

It is plotted with matplotlib on its bundled fonts, without a display. All figures come from the result and its summary.
A :class:`~slam_init.recording.recorder.StoryRecorder` keeps during the run what is shown beside them. The same run
gives the same bytes with the same version of matplotlib.

The head states the verdict, the figures of the map and every note. Below it stand on the left the frames, the pair and
the decision. The right half holds the map; without one it holds the gate that refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from slam_init.evaluation.metrics import true_path
from slam_init.output.summary import Summary
from slam_init.pictures import drawing
from slam_init.recording.recorder import StoryRecorder
from slam_init.recording.text import headline
from slam_init.types.arrays import evenly_spaced
from slam_init.types.initial_map import InitialMap, risk_in_words
from slam_init.types.pose import Trajectory
from slam_init.types.refusal import Gate, GateName, Verdict
from slam_init.types.result import Attempt, Result, Segment

if TYPE_CHECKING:
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


def overview_png(result: Result, summary: Summary, story: StoryRecorder, truth: Trajectory | None = None) -> bytes:
    """Draw the overview of a run.

    * ``truth``: The true trajectory; it is plotted beside the path of an accepted map.
    * Returns: A PNG file of 1600 x 1000 pixels. Equal arguments give equal bytes with the same version of matplotlib.
    """
    import cv2

    with drawing.canvas(_WIDTH, _HEIGHT) as figure:
        top = _draw_head(figure, result, summary) + 40
        _draw_column(figure, top, result, summary, story)
        if len(result.segments) > 1:
            _draw_maps(figure, top, [_of_segment(k, one) for k, one in enumerate(result.segments[:_MOST_SEGMENTS])])
        elif result.map is not None:
            view, path = drawing.widest_view(result.map), true_path(result.map.keyframes, truth)
            axes = drawing.axes_at(figure, _RIGHT, top, _RIGHT_WIDTH, _BOTTOM - top)
            drawing.draw_map(axes, result.map, view, f"the map {view}", path)
            drawing.draw_cameras(axes.inset_axes((0.06, 0.04, 0.24, 0.22)), result.map, view, path)
        elif len(result.hypotheses) == 2:
            _draw_conjugate_maps(figure, top, result)
        else:
            _draw_refusal(figure, top, result)
        image = np.ascontiguousarray(drawing.pixels_of(figure)[..., ::-1])
    # Without any metadata, equal pictures are equal bytes. Other strategies take half as long again, and the file is
    # hardly smaller: images have noise.
    _, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE])
    return encoded.tobytes()


# -- the head --------------------------------------------------------------------------------------


def _draw_head(figure: Figure, result: Result, summary: Summary) -> float:
    """Write the verdict, the figures and the notes; return where they end."""
    y, color = 18.0, drawing.VERDICT_COLORS[result.reason or Verdict.ACCEPTED]
    page = drawing.blank(drawing.axes_at(figure, 0, 0, _WIDTH, _HEIGHT))
    origin = f"source {summary.source.name}, method {summary.method}, seed {summary.seed}"
    wrong = None if result.wrong_focal is None else result.wrong_focal.note
    notes = [f"note: {note}" for note in result.notes if note != wrong]
    lines = [(headline(summary), 25.0, drawing.INK, "bold")]
    lines += [(fact, 12.5, drawing.INK, "normal") for fact in _facts(result)]
    lines += [] if wrong is None else [(wrong, 11.0, drawing.OUTLIER, "bold")]
    lines += [(line, 9.5, drawing.FAINT, "normal") for line in (origin, *notes[:_MOST_NOTES])]
    for text, size, ink, weight in lines:
        shown = drawing.wrapped(text, int(2350 / size), 2)
        drawing.write(page, 46 / _WIDTH, 1 - y / _HEIGHT, shown, size, ink, weight)
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
    sigma = evidence.focal_sigma if map_ is None else map_.camera.focal_sigma or 0.0
    # Where the tracks contradict a stated focal length, a line of its own says so.
    focal = "not stated" if stated.source == "prior" else f"{stated.focal_px:.0f} px ({stated.source})"
    focal += f", fitted {evidence.focal_factor * stated.focal_px:.0f} px +- {sigma:.1%}" if stated.focal_sigma else ""
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
        axes = drawing.axes_at(figure, _LEFT + k * (width + gap), top, width, height)
        drawing.draw_frame(axes, shown, frames[k - 1] if k else None, camera.width, known)
    words = "yellow: tracks and their motion since the frame on the left"
    words += "; green: landmarks" if result.map is not None else ""
    words = words if frames else "no frame was read"
    legend = drawing.blank(drawing.axes_at(figure, _LEFT, top + height, _LEFT_WIDTH, 20))
    drawing.write(legend, 0.0, 0.8, words, 9, drawing.FAINT)
    top += height + 50
    if story.pair is not None:
        aspect = camera.width / camera.height
        height = min(_LEFT_WIDTH / (aspect / 2 if aspect > drawing.WIDE else 2 * aspect), 0.45 * (_BOTTOM - top))
        drawing.draw_pair(drawing.axes_at(figure, _LEFT, top, _LEFT_WIDTH, height), story.pair, camera.width)
        top += height + 60
    height = min(_BOTTOM - top, _DECISION_HEIGHT)
    drawing.draw_decision(drawing.axes_at(figure, _LEFT + 50, top, _LEFT_WIDTH - 210, height), result.attempts)


# -- the maps, or why there is none ----------------------------------------------------------------


def _draw_maps(
    figure: Figure, top: float, maps: Sequence[tuple[InitialMap, str, str]], bottom: float = _BOTTOM
) -> None:
    """Draw several maps, each with its view and its title, two beside one another."""
    rows = -(-len(maps) // 2)
    width, height = (_RIGHT_WIDTH - 40) / 2, (bottom - top) / rows - _TITLE
    for k, (map_, view, title) in enumerate(maps):
        left, above = _RIGHT + k % 2 * (width + 40), top + k // 2 * (height + _TITLE)
        drawing.draw_map(drawing.axes_at(figure, left, above, width, height), map_, view, title)


def _of_segment(number: int, segment: Segment) -> tuple[InitialMap, str, str]:
    """A map of a run that restarted."""
    frames, view = segment.map.keyframes, drawing.widest_view(segment.map)
    end = "followed to the end" if segment.lost_at is None else f"lost at frame {segment.lost_at}"
    facts = f"{len(segment.map.points)} landmarks, {len(segment.located)} further frames located, {end}"
    return segment.map, view, f"map {number + 1} {view}: frames {frames[0].frame} to {frames[-1].frame}\n{facts}"


def _draw_conjugate_maps(figure: Figure, top: float, result: Result) -> None:
    """Both undecided maps from two sides, and what has to decide between them."""
    maps = [
        (map_, view, f"map {name} {view}")
        for view in (drawing.ABOVE, drawing.SIDE)
        for map_, name in zip(result.hypotheses, "AB", strict=True)
    ]
    _draw_maps(figure, top, maps, _BOTTOM - 40)
    box = drawing.blank(drawing.axes_at(figure, _RIGHT, _BOTTOM - 60, _RIGHT_WIDTH, 60))
    color = drawing.VERDICT_COLORS[result.reason or Verdict.AMBIGUOUS_PLANE]
    drawing.write(box, 0.0, 1.0, drawing.wrapped(_deciding(result), 110, 2), 11, color, "bold")


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


def _draw_refusal(figure: Figure, top: float, result: Result) -> None:
    """Why there is no map: what to do in large letters, and the gate that refused with what it got and needed."""
    axes = drawing.blank(drawing.axes_at(figure, _RIGHT, top, _RIGHT_WIDTH, _BOTTOM - top))
    reason = result.reason or Verdict.TOO_FEW_FRAMES
    said, _, advice = (result.advice or reason.advice).partition(": ")
    drawing.write(axes, 0.05, 0.97, drawing.wrapped(said[:1].upper() + said[1:], 60, 2), 18, drawing.INK)
    words = (advice or said)[:1].upper() + (advice or said)[1:]
    drawing.write(axes, 0.05, 0.84, drawing.wrapped(words, 30, 3), 32, drawing.VERDICT_COLORS[reason], "bold")
    # A reason that no gate names, such as a wrong focal length, stands in the advice alone.
    last = next((one for one in reversed(result.attempts) if one.failed_gates and one.verdict == reason), None)
    if last is None:
        return
    name, got, needed = _gate_words(last.failed_gates[0])
    frames = " and ".join(map(str, last.frames[:2]))
    drawing.write(axes, 0.05, 0.44, f"the gate that refused, last at frames {frames}: {name}", 14, drawing.INK)
    for x, title, value in ((0.05, "got", got), (0.45, "needs", needed)):
        drawing.write(axes, x, 0.34, title, 14, drawing.FAINT)
        drawing.write(axes, x, 0.28, value, 30, drawing.OUTLIER if title == "got" else drawing.INK, "bold")


def _gate_words(gate: Gate) -> tuple[str, str, str]:
    """Write the name of a gate, what it got and what it needs."""
    if gate.name is GateName.FOCAL_SIGMA:
        return "deviation of the focal length", f"{gate.value:.0%}", f"at most {gate.threshold:.0%}"
    unit = f" {gate.unit}" if gate.unit else ""
    name = str(gate.name).removesuffix(f"_{gate.unit}").replace("_", " ")
    return name, f"{gate.value:.3g}{unit}", f"{gate.direction.replace('_', ' ')} {gate.threshold:.3g}{unit}"
