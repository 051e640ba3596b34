"""Attempts and summaries in words, for the recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from slam_init.types.reasons import ACCEPTED
from slam_init.types.result import Attempt

__all__ = ["attempt_line", "attempt_markdown", "summary_markdown"]

#: Keys of the summary that a table of one line each cannot show, or that no two runs share.
_LISTS = ("keyframes", "attempts", "timing_ms", "notes", "hypotheses")


def attempt_line(attempt: Attempt) -> str:
    """One line: the frames, the verdict and what would help."""
    advice = f": {attempt.advice}" if attempt.advice else ""
    return f"frames {', '.join(map(str, attempt.frames))} {attempt.verdict}{advice}"


def attempt_markdown(attempt: Attempt) -> str:
    """The verdict as a heading, the advice, what was compared with what, then the rest of the evidence."""
    sign = "accepted" if attempt.verdict == ACCEPTED else f"refused: {attempt.verdict}"
    lines = [f"### {sign}", f"frames {', '.join(map(str, attempt.frames))}", ""]
    if attempt.advice:
        lines += [attempt.advice, ""]
    evidence = attempt.evidence
    gates = {name: gate for gate in evidence if (name := _gated(gate)) in evidence and name != gate}
    if gates:
        lines += ["| gate | value | threshold |", "|---|---:|---:|"]
        lines += [f"| {name} | {_shown(evidence[name])} | {_shown(evidence[gate])} |" for name, gate in gates.items()]
        lines.append("")
    rest = {name: value for name, value in evidence.items() if name not in gates and name not in gates.values()}
    return "\n".join(lines + _table("evidence", rest))


def _gated(name: str) -> str:
    """The evidence that a threshold is for: ``landmarks`` of ``landmarks_gate``, ``matches`` of ``matches_needed``."""
    return name.replace("_gate", "").removesuffix("_needed")


def summary_markdown(summary: Mapping[str, Any]) -> str:
    """The figures of a summary as tables, its keyframes listed."""
    reason = f": {summary['reason']}" if summary.get("reason") else ""
    plain = {k: v for k, v in summary.items() if k not in _LISTS and not isinstance(v, Mapping)}
    lines = [f"# {summary.get('status', 'run')}{reason}", *_table("figure", plain)]
    for name in ("margin", "ground_truth", "camera", "focal_length", "source", "continued"):
        if isinstance(summary.get(name), Mapping):
            lines += ["", *_table(name, summary[name])]
    if summary.get("keyframes"):
        frames = ", ".join(str(keyframe["frame"]) for keyframe in summary["keyframes"])
        lines += ["", f"Keyframes: {frames}"]
    verdicts = [attempt["verdict"] for attempt in summary.get("attempts", ())]
    counts = {verdict: verdicts.count(verdict) for verdict in dict.fromkeys(verdicts)}
    if counts:
        lines += ["", *_table("attempts", counts)]
    return "\n".join([*lines, "", *(f"- {note}" for note in summary.get("notes", ()))])


def _table(title: str, rows: Mapping[str, Any]) -> list[str]:
    return [
        f"| {title} | |",
        "|---|---:|",
        *(f"| {name} | {_shown(value)} |" for name, value in rows.items()),
    ]


def _shown(value: Any) -> str:
    if value is None:
        return "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value).replace("|", "/")
