"""Texts of attempts and summaries for the recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from slam_init.errors import plain_line
from slam_init.output.plain_json import Json, plain_fields
from slam_init.output.summary import Summary
from slam_init.recording.layout import ARROW_FACTOR
from slam_init.types.gates import Direction, Gate, GateName
from slam_init.types.reasons import Verdict, in_words
from slam_init.types.result import Attempt, why_no_map

#: Fields of the summary that have one line each.
_FIGURES = (
    "schema",
    "reason",
    "advice",
    "method",
    "seed",
    "frames_read",
    "frames_to_init",
    "landmarks",
    "median_parallax_deg",
    "depth_sigma",
    "reprojection_rmse_px",
    "scene",
)
#: Fields that have a table each. Times and provenance are left out, since they differ between equal runs.
_TABLES = ("margin", "ground_truth", "camera", "focal_length", "source", "continued")


def attempt_line(attempt: Attempt) -> str:
    """Write one line: the verdict, the frames and the advice.

    * Returns: The verdict comes first, because the view of the log cuts long lines.
    """
    advice = f": {attempt.advice}" if attempt.advice else ""
    return f"{in_words(attempt.verdict)}, frames {_frames(attempt)}{advice}"


def attempt_markdown(attempt: Attempt) -> str:
    """Write the verdict, the advice and the gates, short enough for a small panel.

    * Returns: In Markdown, without headings: those of the viewer are large.
    """
    accepted = attempt.verdict == Verdict.ACCEPTED
    verdict = "accepted" if accepted else f"refused: {in_words(attempt.verdict)}"
    lines = [f"**{verdict}**, frames {_frames(attempt)}", ""]
    if attempt.advice:
        lines += [attempt.advice, ""]
    if attempt.free_focal is not None and attempt.free_focal.contradicts:
        lines += [f"**{attempt.free_focal.note}**", ""]
    if attempt.gates:
        lines += ["| gate | value | needs | |", "|---|---:|---:|---|", *map(_gate_row, attempt.gates), ""]
    if attempt.window is not None and not accepted:
        window = attempt.window
        terms = (
            ("the direction is uncertain", window.risk_direction),
            ("another motion", window.risk_rival),
            ("a camera that only rotates", window.risk_rotation),
            ("moving bodies", window.risk_moving),
        )
        name, term = max(terms, key=lambda pair: pair[1])
        lines.append(f"largest part of the risk: {name}, {term:.2g}")
    return "\n".join(lines)


def evidence_markdown(attempt: Attempt) -> str:
    """Write all evidence of an attempt by name, in one flat table, without the unknown figures."""
    parts = (
        ("", attempt.preview),
        ("two_view_", attempt.two_view),
        ("free_focal_", attempt.free_focal),
        ("", attempt.window),
        ("", attempt.map),
    )
    rows: dict[str, Json] = dict(attempt.method_evidence)
    for prefix, part in parts:
        figures = {} if part is None else plain_fields(part)
        statistics = figures.pop("statistics", None)
        if isinstance(statistics, Mapping):
            figures |= statistics
        rows |= {f"{prefix}{name}": value for name, value in figures.items()}
    known = {name: value for name, value in rows.items() if value is not None}
    return "\n".join(_table(f"frames {_frames(attempt)}", known))


def conjugate_maps_markdown(attempt: Attempt | None) -> str:
    """Write what has to decide between two maps."""
    if attempt is not None and attempt.verdict == Verdict.MOVING_BODIES:
        return "The tracks of A are at rest and those of B move, or the other way round: one of the maps is right."
    lines = ["Two motions explain these views of a plane: one of the maps is right.", ""]
    bound = None if attempt is None else next((g for g in attempt.gates if g.name is GateName.RISK), None)
    if attempt is not None and attempt.window is not None and bound is not None:
        lines += [
            f"The risk that it is B is **{attempt.window.risk_rival:.2g}**. All terms together are {bound.value:.2g}; "
            f"at **{bound.threshold:.2g}** the map is handed over."
        ]
    return "\n".join(lines)


def legend_markdown() -> str:
    """Write what the colours of the views mean."""
    rows = (
        ("map, keyframes", "blue", "estimated cameras and path"),
        ("map, keyframes", "orange", "true path, aligned"),
        ("map", "yellow", "camera of the newest frame, with its image"),
        ("map, keyframes", "purple", "paths of map A and map B"),
        ("frame", "green", "tracks"),
        ("frame", "yellow", "motion over three frames"),
        ("frame, pair", "purple", "on a body that moves"),
        ("pair", "green, red", "inliers, outliers"),
        ("pair", "yellow", "no motion was estimated"),
        ("shutter", "yellow", "pixels as read"),
        ("shutter", "purple", f"corrected; arrows are {ARROW_FACTOR} times as long"),
        ("log10 risk", "red", "bound; below it the map is handed over"),
        ("log10 risk", "purple", "the risk that the map is wrong"),
        ("parts", "light blue, pink, grey, brown", "its parts: direction, other motion, rotation, moving bodies"),
        ("counts", "blue, green", "tracks, landmarks"),
        ("ms", "blue", "time of a frame"),
        ("ms", "red", "time between two frames at 30 Hz"),
    )
    return "\n".join(["| view | colour | |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in rows)])


def headline(summary: Summary) -> str:
    """Write in one line whether there is a map, and why not."""
    if summary.reason is None:
        return f"Initialized after {summary.frames_to_init} frames"
    return f"No map after {summary.frames_read} frames: {why_no_map(summary.reason, summary.wrong_focal)}"


def advice_markdown(summary: Summary) -> str:
    """Write the result of a run in large letters: initialized, or why not and what to do."""
    title = f"# {headline(summary)}"
    if summary.reason is None:
        return title if summary.wrong_focal is None else f"{title}\n\n# {summary.wrong_focal.note}"
    said, _, advice = summary.advice.partition(": ")
    return f"{title}\n\n{said}\n\n# {advice or said}"


def summary_markdown(summary: Summary) -> str:
    """Write the figures of a summary as tables, with a list of its keyframes."""
    fields = summary.as_dict()
    reason = f": {summary.reason}" if summary.reason else ""
    lines = [f"# {summary.status}{reason}", *_table("figure", {name: fields[name] for name in _FIGURES})]
    for name in _TABLES:
        table = fields[name]
        if isinstance(table, Mapping):
            lines += ["", *_table(name, table)]
    if summary.keyframes:
        frames = ", ".join(str(keyframe.frame) for keyframe in summary.keyframes)
        lines += ["", f"Keyframes: {frames}"]
    counts = Counter(str(attempt.verdict) for attempt in summary.attempts)
    if counts:
        lines += ["", *_table("attempts", counts)]
    return "\n".join([*lines, "", *(f"- {plain_line(note)}" for note in summary.notes)])


def _frames(attempt: Attempt) -> str:
    return ", ".join(map(str, attempt.frames))


def _gate_row(gate: Gate) -> str:
    sign = "≥" if gate.direction is Direction.AT_LEAST else "≤"
    mark = "" if gate.passes() else "**fails**"
    return f"| {gate.name} | {_shown(gate.value)} | {sign} {_shown(gate.threshold)} | {mark} |"


def _table(title: str, rows: Mapping[str, Json] | Mapping[str, int]) -> list[str]:
    return [f"| {title} | |", "|---|---:|", *(f"| {name} | {_shown(value)} |" for name, value in rows.items())]


def _shown(value: Json) -> str:
    if value is None:
        return "none"
    return f"{value:.4g}" if isinstance(value, float) else plain_line(str(value)).replace("|", "/")
