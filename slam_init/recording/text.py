"""Texts of attempts and summaries for the recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from slam_init.errors import plain_line
from slam_init.output.plain_json import Json, plain_fields
from slam_init.output.summary import Summary
from slam_init.types.gates import Direction, Gate
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt

__all__ = ["attempt_line", "attempt_markdown", "summary_markdown"]

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
    "reprojection_rmse_px",
    "scene",
)
#: Fields that have a table each. Times and provenance are left out, since they differ between equal runs.
_TABLES = ("margin", "ground_truth", "camera", "focal_length", "source", "continued")


def attempt_line(attempt: Attempt) -> str:
    """Write one line: the frames, the verdict and the advice.

    Parameters
    ----------
    attempt : Attempt

    Returns
    -------
    str
    """
    advice = f": {attempt.advice}" if attempt.advice else ""
    return f"frames {', '.join(map(str, attempt.frames))} {attempt.verdict}{advice}"


def attempt_markdown(attempt: Attempt) -> str:
    """Write the verdict as a heading, then the advice, the gates, and the rest of the evidence.

    Parameters
    ----------
    attempt : Attempt

    Returns
    -------
    str
        In Markdown.
    """
    verdict = "accepted" if attempt.verdict == Verdict.ACCEPTED else f"refused: {attempt.verdict}"
    lines = [f"### {verdict}", f"frames {', '.join(map(str, attempt.frames))}", ""]
    if attempt.advice:
        lines += [attempt.advice, ""]
    if attempt.gates:
        lines += ["| gate | value | threshold | |", "|---|---:|---:|---|"]
        lines += [_gate_row(gate) for gate in attempt.gates]
        lines.append("")
    return "\n".join(lines + _table("evidence", _evidence(attempt)))


def summary_markdown(summary: Summary) -> str:
    """Write the figures of a summary as tables, with a list of its keyframes.

    Parameters
    ----------
    summary : Summary

    Returns
    -------
    str
        In Markdown.
    """
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


def _gate_row(gate: Gate) -> str:
    sign = "≥" if gate.direction is Direction.AT_LEAST else "≤"
    mark = "" if gate.passes() else "**fails**"
    return f"| {gate.name} | {_shown(gate.value)} | {sign} {_shown(gate.threshold)} | {mark} |"


def _evidence(attempt: Attempt) -> dict[str, Json]:
    """Return all evidence of an attempt by name, in one flat table, without the unknown figures."""
    rows: dict[str, Json] = dict(attempt.method_evidence)
    if attempt.preview is not None:
        rows |= plain_fields(attempt.preview)
    if attempt.two_view is not None:
        figures = plain_fields(attempt.two_view)
        statistics = figures.pop("statistics")
        rows |= {f"two_view_{name}": value for name, value in figures.items()}
        if isinstance(statistics, Mapping):
            rows |= {f"two_view_{name}": value for name, value in statistics.items()}
    if attempt.rotation_only is not None:
        rows |= {f"rotation_only_{name}": value for name, value in plain_fields(attempt.rotation_only).items()}
    if attempt.window is not None:
        rows |= plain_fields(attempt.window)
    if attempt.map is not None:
        rows |= plain_fields(attempt.map)
    return {name: value for name, value in rows.items() if value is not None}


def _table(title: str, rows: Mapping[str, Json] | Mapping[str, int]) -> list[str]:
    return [
        f"| {title} | |",
        "|---|---:|",
        *(f"| {name} | {_shown(value)} |" for name, value in rows.items()),
    ]


def _shown(value: Json) -> str:
    if value is None:
        return "none"
    return f"{value:.4g}" if isinstance(value, float) else plain_line(str(value)).replace("|", "/")
