"""``overview.png``: what a run saw, what it decided and why, in one image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam_init.evaluation.metrics import true_path
from slam_init.output.summary import Summary
from slam_init.pictures.map_panels import ABOVE, SIDE, draw_cameras, draw_map
from slam_init.pictures.panels import draw_decision, draw_frame, draw_pair
from slam_init.pictures.story import Story
from slam_init.pictures.style import (
    FAINT,
    INK,
    INLIER,
    OUTLIER,
    VERDICT_COLORS,
    canvas,
    gate_words,
    png_of,
    wrapped,
    write,
)
from slam_init.types.arrays import evenly_spaced
from slam_init.types.gates import Gate, GateName
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Trajectory
from slam_init.types.reasons import Verdict, in_words
from slam_init.types.result import Attempt, Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH_PX, _HEIGHT_PX = 1600, 1000
#: The parts, from the top: title, frames, pair and map, decision. Left, bottom, width and height as shares.
_TITLE = (0.02, 0.89, 0.96, 0.09)
_FRAMES = (0.02, 0.675, 0.96, 0.185)
_PAIR = (0.02, 0.315, 0.44, 0.315)
_MAP = (0.48, 0.315, 0.50, 0.315)
_DECISION = (0.055, 0.055, 0.765, 0.185)
#: Width of the legend beside the strip of frames.
_LEGEND = 0.135
#: Most maps of a run that started anew; each has a row.
_MOST_SEGMENTS = 4
#: Most frames in the strip; fewer where images are wide.
_MOST_FRAMES = 6
Box = tuple[float, float, float, float]


def overview_png(result: Result, summary: Summary, story: Story, truth: Trajectory | None = None) -> bytes:
    """Draw the overview of a run.

    * ``truth``: The true trajectory; it is drawn beside the path of an accepted map.
    * Returns: A PNG file of 1600 x 1000 pixels. Equal arguments give equal bytes with the same version of matplotlib.
    """
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
        return png_of(figure)


def _blank(figure: Figure, box: Box) -> Axes:
    """Axes for text alone."""
    axes = figure.add_axes(box)
    axes.axis("off")
    return axes


def _draw_title(axes: Axes, result: Result, summary: Summary) -> None:
    """The verdict in words, the figures of the map, and what was run."""
    if result.map is not None:
        color, title = INLIER, f"Initialized after {result.frames_to_init} frames"
    else:
        reason = result.reason or Verdict.TOO_FEW_FRAMES
        color, title = VERDICT_COLORS[reason], f"No map after {result.frames_read} frames: {in_words(reason)}"
    axes.plot([0.0, 0.0], [0.0, 1.0], color=color, linewidth=10, transform=axes.transAxes, clip_on=False)
    write(axes, 0.012, 1.02, title, 25, INK, "bold")
    write(axes, 0.012, 0.47, wrapped(_subtitle(result), 150, 1), 13, INK)
    origin = f"source {summary.source.name}, method {summary.method}, seed {summary.seed}"
    write(axes, 0.012, 0.17, wrapped(origin, 190, 1), 9.5, FAINT)
    if result.wrong_focal is not None:
        write(axes, 0.5, 0.9, wrapped(result.wrong_focal.note, 100, 1), 11.5, OUTLIER, "bold")


def _subtitle(result: Result) -> str:
    if len(result.segments) > 1:
        begun = "a new one was begun where the one before was lost"
        return f"{len(result.segments)} maps: {begun}. Frames, pair and risk are those of the first."
    if result.map is None:
        if result.hypotheses:
            return "Two maps explain the views, and one of them is right. Both are kept until further views decide."
        return f"attempts: {len(result.attempts)}; {_missing(result)}."
    map_ = result.map
    facts = [
        f"{len(map_.keyframes)} keyframes",
        f"{len(map_.points)} landmarks, {map_.scene} scene",
        f"parallax {map_.median_parallax_deg:.2f} deg",
        f"reprojection {map_.reprojection_rmse_px:.2f} px",
    ]
    window = result.attempts[-1].window if result.attempts else None
    if window is not None:
        facts.insert(0, f"risk {window.risk:.2g} that the map is wrong")
    return "  |  ".join(facts)


def _missing(result: Result) -> str:
    """What a map has to have before it is handed over, and this run had not."""
    failed = [gate.name for one in result.attempts[-1:] for gate in one.failed_gates]
    if failed and GateName.RISK not in failed:
        return "a map is handed over once its risk and all other conditions are met"
    return "no map is handed over before its risk is small enough"


def _draw_frames(figure: Figure, result: Result, summary: Summary, story: Story) -> None:
    """The strip of frames: as many as fit beside one another."""
    left, bottom, width, height = _FRAMES
    camera = summary.camera
    each = height * _HEIGHT_PX / _WIDTH_PX * camera.width / camera.height
    strip = width - _LEGEND
    most = int(np.clip(strip / each, 1, _MOST_FRAMES))
    chosen = [story.frames[k] for k in evenly_spaced(len(story.frames), most)] if story.frames else []
    gap = 0.008
    each = min(each, (strip + gap) / max(len(chosen), 1) - gap)
    landmarks = None if result.map is None else result.map.track_ids
    for k, shown in enumerate(chosen):
        axes = figure.add_axes((left + k * (each + gap), bottom, each, height))
        known = None if landmarks is None else np.isin(shown.track_ids, landmarks)
        draw_frame(axes, shown, chosen[k - 1] if k else None, camera.width, known)
    if not chosen:
        write(_blank(figure, _FRAMES), 0.0, 0.6, "no frame was read", 12, FAINT)
        return
    legend = _blank(figure, (left + len(chosen) * (each + gap) + 0.004, bottom, _LEGEND, height))
    words = "yellow: tracks, and how\nthey moved since the\nframe on the left"
    if landmarks is not None:
        words += "\n\ngreen: landmarks of the map"
    write(legend, 0.0, 0.95, words, 9.5, FAINT)


def _draw_map(figure: Figure, map_: InitialMap, truth: Trajectory | None) -> None:
    """The map from above and from the side, and its cameras alone."""
    path = true_path(map_.keyframes, truth)
    left, bottom, width, height = _MAP
    gap = 0.01
    large = 0.36 * width
    beside = width - 2 * large - 2 * gap
    above = figure.add_axes((left, bottom, large, height))
    draw_map(above, map_, ABOVE, "the map from above", path)
    draw_map(figure.add_axes((left + large + gap, bottom, large, height)), map_, SIDE, "from the side", path)
    x = left + 2 * (large + gap)
    draw_cameras(figure.add_axes((x, bottom + 0.52 * height, beside, 0.48 * height)), map_, ABOVE, path)
    draw_cameras(figure.add_axes((x, bottom, beside, 0.40 * height)), map_, SIDE, path)
    handles, labels = above.get_legend_handles_labels()
    above.legend(
        handles,
        labels,
        loc="upper left",
        bbox_to_anchor=(-0.02, -0.005),
        ncol=2,
        fontsize=9,
        frameon=False,
        borderpad=0,
    )


def _draw_segments(figure: Figure, result: Result) -> None:
    """The maps of a run that started anew, a row for each: from above, from the side, and in words."""
    left, bottom, width, height = _MAP
    shown = result.segments[:_MOST_SEGMENTS]
    gap = 0.02
    each = (height + gap) / len(shown) - gap
    large = 0.3 * width
    for k, segment in enumerate(shown):
        low = bottom + height - (k + 1) * each - k * gap
        draw_map(figure.add_axes((left, low, large, each)), segment.map, ABOVE, f"map {k + 1} from above")
        draw_map(figure.add_axes((left + large + 0.01, low, large, each)), segment.map, SIDE, "from the side")
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
        x = left + k * (each + gap)
        draw_map(figure.add_axes((x, bottom, half, height)), map_, ABOVE, f"map {name} from above")
        side = figure.add_axes((x + half + 0.004, bottom, half, height))
        draw_map(side, map_, SIDE, f"map {name} from the side")
    box = _blank(figure, (left, bottom - 0.045, width, 0.04))
    color = VERDICT_COLORS[result.reason or Verdict.AMBIGUOUS_PLANE]
    write(box, 0.0, 1.0, wrapped(" ".join(_deciding(result)), 85, 2), 11, color, "bold")


def _deciding(result: Result) -> list[str]:
    """The evidence that has to decide between two maps: their vote, and the risk by another motion."""
    if result.reason == Verdict.MOVING_BODIES:
        return ["The tracks of A are at rest and those of B move, or the other way round."]
    facts = []
    if result.margin is not None:
        facts.append(f"The tracks {result.margin.in_words('A', 'B')}.")
    last = next((one for one in reversed(result.attempts) if one.window is not None), None)
    if last is not None and last.window is not None:
        bound = next((f" (bound {gate.threshold:g})" for gate in last.gates if gate.name is GateName.RISK), "")
        facts.append(f"The risk that it is B is {last.window.risk_rival:.2g}{bound}.")
    return facts


def _draw_reason(axes: Axes, result: Result) -> None:
    """Why there is no map: the advice in large letters, and the condition that failed."""
    reason = result.reason or Verdict.TOO_FEW_FRAMES
    said, _, advice = (result.advice or reason.advice).partition(": ")
    write(axes, 0.03, 0.97, wrapped(said[:1].upper() + said[1:], 52, 2), 17, INK)
    lines = wrapped((advice or said)[:1].upper() + (advice or said)[1:], 26, 3)
    write(axes, 0.03, 0.73, lines, 31, VERDICT_COLORS[reason], "bold")
    facts = [f"frames {one.frames[0]} and {one.frames[1]}: {gate_words(gate)}" for one, gate in _held(result, reason)]
    write(axes, 0.03, 0.12, "\n".join(["what held it last", *facts[:2]]) if facts else "", 11, FAINT)


def _held(result: Result, reason: Verdict) -> list[tuple[Attempt, Gate]]:
    """The gates that failed in the last attempt that a gate refused for the reason."""
    refused = (one for one in reversed(result.attempts) if one.verdict == reason and len(one.frames) > 1)
    last = next((one for one in refused if one.failed_gates), None)
    return [] if last is None else [(last, gate) for gate in last.failed_gates]
