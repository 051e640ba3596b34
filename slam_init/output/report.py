"""The report of a run as text for a terminal: that of its result, with what only the run knows."""

from __future__ import annotations

import os
from pathlib import Path

from quest.display import aligned
from slam_init.errors import plain_line
from slam_init.output.summary import SegmentRecord, Summary
from slam_init.types.result import Result, report_facts


def report_text(result: Result, summary: Summary, out: str | os.PathLike[str], replaced: str | None = None) -> str:
    """Write a few aligned lines: the verdict, the quality of the map, and the folder of the results.

    * ``replaced``: The earlier result that was in the folder.
    """
    title, facts = report_facts(result, _run_facts(summary))
    folder = plain_line(str(Path(out)))
    if replaced is not None:
        facts = [*facts, ("replaced", plain_line(replaced))]
    return (
        aligned(title, [*facts, ("results", f"{folder}/ (look at overview.png, or: slam-init view {folder})")]) + "\n"
    )


def _run_facts(summary: Summary) -> list[tuple[str, str]]:
    """Return the lines about the frames after the map, the ground truth, and further maps."""
    facts = []
    if continued := summary.continued:
        located = f"{continued.located} of {continued.frames} further frames located"
        survival = continued.survival_median
        seen = "" if survival is None else f", {survival:.0%} of the landmarks seen (median)"
        facts.append(("continued", located + seen))
    if truth := summary.ground_truth:
        named = (
            ("rotation", truth.rotation_error_deg, " deg"),
            ("direction", truth.direction_error_deg, " deg"),
            ("ATE", truth.ate_rmse, ""),
        )
        errors = [f"{name} {value:.3g}{unit}" for name, value, unit in named if value is not None]
        if truth.scale_error is not None:
            errors.append(f"scale {truth.scale_error:+.1%}")
        known = ""
        if truth.direction_may_be_right:
            baseline = f"baseline of {100 * (truth.true_baseline or 0.0):.2g} cm"
            known = f"; the true direction is known to about {truth.true_direction_sigma_deg:.2g} deg ({baseline})"
        facts.append(("ground truth", ", ".join(errors) + known or "too little motion to compare with"))
    return [*facts, *(_segment_fact(segment) for segment in summary.segments)]


def _segment_fact(segment: SegmentRecord) -> tuple[str, str]:
    """Return the line about a map of a run that restarts after a loss."""
    frames = f"frames {segment.keyframes[0].frame} to {segment.keyframes[-1].frame}"
    end = "followed to the end" if segment.lost_at is None else f"lost at frame {segment.lost_at}"
    scale = "" if segment.scale is None else f", 1 unit = {segment.scale:.4g} m"
    located = f"{segment.continued.located} further frames located"
    return (segment.folder, f"{segment.landmarks} landmarks, {frames}{scale}, {located}, {end}")
