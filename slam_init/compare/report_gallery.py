"""The galleries of the report: the worst maps, and trials without a map."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from slam_init.compare.failure_gallery import failure_cases, waiting_cases
from slam_init.compare.trial_table import TrialTable
from slam_init.methods.external_command import method_label

if TYPE_CHECKING:
    from slam_init.compare.plan import Plan


def gallery_section(table: TrialTable, plan: Plan) -> str:
    """Show the worst trials."""
    cases = []
    for case in failure_cases(table, {source.label: source.text for source in plan.sources}):
        text = {name: str(values[case.row]) for name, values in table.text.items()}
        rotation, direction = (table.numbers[f"{name}_error_deg"][case.row] for name in ("rotation", "direction"))
        errors = [f"{name} {v:.1f}&deg;" for name, v in (("rotation", rotation), ("direction", direction)) if v == v]
        picture = (
            f'<img alt="first and last keyframe" src="data:image/jpeg;base64,{case.picture}">' if case.picture else ""
        )
        frames, outcome = text["keyframes"].split(), text["outcome"]
        cases.append(
            f'<div class="case">{picture}<p><span class="tag {outcome}">{outcome}</span> '
            f"<b>{escape(method_label(text['method']))}</b> {', '.join(errors) or 'no true baseline'}<br>"
            f'<span class="soft">{escape(text["source"])}, start {table.numbers["start"][case.row]:.0f}, '
            f"keyframes {frames[0]} and {frames[-1]}</span></p></div>"
        )
    shown = (
        f'<div class="cases">{"".join(cases)}</div>'
        if cases
        else "<p>None: no map is false, and no error is above half of a bound.</p>"
    )
    return (
        '<h2 id="worst">Worst cases</h2><p class="soft">False maps first, then correct maps with an error above half '
        "of a bound; at most two maps of a method in a scene. The pictures show the first and the last keyframe, or "
        "the motion of the tracks between them.</p>" + shown
    )


def waiting_section(table: TrialTable, plan: Plan) -> str:
    """Show trials without a map although one can be correct: what the method saw, and why it has none."""
    cases = []
    for case in waiting_cases(table, {source.label: source.text for source in plan.sources}):
        text = {name: str(values[case.row]) for name, values in table.text.items()}
        start, limit = (int(table.numbers[name][case.row]) for name in ("start", "frames_limit"))
        alt = "first and last frame that the method could read"
        picture = f'<img alt="{alt}" src="data:image/jpeg;base64,{case.picture}">' if case.picture else ""
        reason = text["reason"].replace("_", " ") or "no reason"
        cases.append(
            f'<div class="case">{picture}<p><span class="tag {text["outcome"]}">{text["outcome"]}</span> '
            f"<b>{escape(method_label(text['method']))}</b> {escape(reason)}<br>"
            f'<span class="soft">{escape(text["source"])}, frames {start} to {start + limit - 1}</span></p></div>'
        )
    shown = f'<div class="cases">{"".join(cases)}</div>' if cases else "<p>None: each solvable trial has a map.</p>"
    return (
        '<h2 id="waiting">No map, where one can be correct</h2><p class="soft">Trials that ended without a map or with '
        "an error; one of each method and scene, those with the most frames first. The pictures show the first and the "
        "last frame that the method could read, or the motion of the tracks between them.</p>" + shown
    )
