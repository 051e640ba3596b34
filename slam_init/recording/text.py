"""Texts of attempts and of the result for the recording."""

from __future__ import annotations

from collections.abc import Mapping

from slam_init.errors import plain_line
from slam_init.output.plain_json import Json, plain_fields
from slam_init.output.summary import Summary
from slam_init.types.refusal import Direction, Gate, GateName, Verdict, in_words
from slam_init.types.result import Attempt


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
    if attempt.gates:
        lines += ["| gate | value | needs | |", "|---|---:|---:|---|", *map(_gate_row, attempt.gates), ""]
    if attempt.window is not None and not accepted:
        window = attempt.window
        terms = (
            ("the direction is uncertain", window.risk_direction),
            ("another motion", window.risk_competing),
            ("a camera that only rotates", window.risk_rotation),
            ("moving objects", window.risk_moving),
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
    rows_of_table = (f"| {name} | {_shown(value)} |" for name, value in rows.items() if value is not None)
    return "\n".join([f"| frames {_frames(attempt)} | |", "|---|---:|", *rows_of_table])


def conjugate_maps_markdown(attempt: Attempt | None) -> str:
    """Write what has to decide between two maps."""
    if attempt is not None and attempt.verdict == Verdict.MOVING_OBJECTS:
        return "The tracks of A are at rest and those of B move, or the other way round: one of the maps is right."
    lines = ["Two motions explain these views of a plane: one of the maps is right.", ""]
    bound = None if attempt is None else next((g for g in attempt.gates if g.name is GateName.RISK), None)
    if attempt is not None and attempt.window is not None and bound is not None:
        lines += [
            f"The risk that it is B is **{attempt.window.risk_competing:.2g}**. The sum of all terms is "
            f"{bound.value:.2g}; the map is accepted at **{bound.threshold:.2g}**."
        ]
    return "\n".join(lines)


def headline(summary: Summary) -> str:
    """Write in one line whether there is a map, and why not."""
    if summary.reason is None:
        return f"Initialized after {summary.frames_to_init} frames"
    return f"No map after {summary.frames_read} frames: {in_words(summary.reason)}"


def advice_markdown(summary: Summary) -> str:
    """Write the result of a run in large letters: initialized, or why not and what to do. Then its notes."""
    parts = [f"# {headline(summary)}"]
    if summary.reason is not None:
        said, _, advice = summary.advice.partition(": ")
        parts += [said, f"# {advice or said}"]
    elif summary.wrong_focal is not None:
        parts.append(f"# {summary.wrong_focal.note}")
    notes = [f"- {plain_line(note)}" for note in summary.notes if f"# {note}" not in parts]
    return "\n\n".join([*parts, *notes])


def _frames(attempt: Attempt) -> str:
    return ", ".join(map(str, attempt.frames))


def _gate_row(gate: Gate) -> str:
    sign = "≥" if gate.direction is Direction.AT_LEAST else "≤"
    mark = "" if gate.passes() else "**fails**"
    return f"| {gate.name} | {_shown(gate.value)} | {sign} {_shown(gate.threshold)} | {mark} |"


def _shown(value: Json) -> str:
    if value is None:
        return "none"
    return f"{value:.4g}" if isinstance(value, float) else plain_line(str(value)).replace("|", "/")
