"""The galleries of the report: the worst maps, and trials without a map."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from slam_init.compare.failure_gallery import FailureCase, failure_cases, waiting_cases
from slam_init.compare.trial_table import TrialTable
from slam_init.methods.external_command import method_label

if TYPE_CHECKING:
    from slam_init.compare.plan import Plan


def gallery_section(table: TrialTable, plan: Plan) -> str:
    """Show the worst trials."""
    cases = []
    for case in failure_cases(table, {source.label: source.text for source in plan.sources}):
        errors = {name: table.numbers[f"{name}_error_deg"][case.row] for name in ("rotation", "direction")}
        known = [f"{name} {error:.1f}&deg;" for name, error in errors.items() if error == error]
        frames = table.text["keyframes"][case.row].split()
        between = f", keyframes {frames[0]} and {frames[-1]}" if frames else ""
        place = f"start {table.numbers['start'][case.row]:.0f}{between}"
        cases.append(_case(table, case, "first and last keyframe", ", ".join(known) or "no true baseline", place))
    return _section(
        "worst",
        "Worst cases",
        "False maps first, then correct maps with an error above half of a bound; at most two maps of a method in a "
        "scene. The pictures show the first and the last keyframe, or the motion of the tracks between them.",
        cases,
        "None: no map is false, and no error is above half of a bound.",
    )


def waiting_section(table: TrialTable, plan: Plan) -> str:
    """Show trials without a map although one can be correct: what the method saw, and why it has none."""
    cases = []
    for case in waiting_cases(table, {source.label: source.text for source in plan.sources}):
        start, limit = (int(table.numbers[name][case.row]) for name in ("start", "frames_limit"))
        reason = escape(table.text["reason"][case.row].replace("_", " ")) or "no reason"
        alt = "first and last frame that the method could read"
        cases.append(_case(table, case, alt, reason, f"frames {start} to {start + limit - 1}"))
    return _section(
        "waiting",
        "No map, where one can be correct",
        "Trials that ended without a map or with an error; one of each method and scene, those with the most frames "
        "first. The pictures show the first and the last frame that the method could read, or the motion of the tracks "
        "between them.",
        cases,
        "None: each solvable trial has a map.",
    )


def _case(table: TrialTable, case: FailureCase, alt: str, fact: str, place: str) -> str:
    text = {name: str(values[case.row]) for name, values in table.text.items()}
    picture = f'<img alt="{alt}" src="data:image/jpeg;base64,{case.picture}">' if case.picture else ""
    return (
        f'<div class="case">{picture}<p><span class="tag {text["outcome"]}">{text["outcome"]}</span> '
        f"<b>{escape(method_label(text['method']))}</b> {fact}<br>"
        f'<span class="soft">{escape(text["source"])}, {place}</span></p></div>'
    )


def _section(name: str, title: str, about: str, cases: Sequence[str], none: str) -> str:
    shown = f'<div class="cases">{"".join(cases)}</div>' if cases else f"<p>{none}</p>"
    return f'<h2 id="{name}">{title}</h2><p class="soft">{about}</p>{shown}'
