"""The summary of a run as text for a terminal."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

from slam_init.errors import plain_line
from slam_init.output.records import SegmentRecord
from slam_init.output.summary import Summary
from slam_init.types.reasons import in_words


def report_text(summary: Summary, out: str | os.PathLike[str]) -> str:
    """Write a few aligned lines: the verdict, the quality of the map, and the folder of the results."""
    out = Path(out)
    if summary.reason is None:
        title, facts = f"initialized after {summary.frames_to_init} frames", _map_facts(summary)
    else:
        title = f"not initialized: {in_words(summary.reason)}"
        facts = [("advice", summary.advice), ("frames read", str(summary.frames_read)), *_kept_facts(summary)]
    facts += [("attempts", _attempts(summary)), *(("note", note) for note in summary.notes)]
    facts.append(("results", f"{out}/ (look at it: slam-init view {out})"))
    return f"{title}\n" + "".join(f"  {name:<14}{plain_line(value)}\n" for name, value in facts)


def _kept_facts(summary: Summary) -> list[tuple[str, str]]:
    """Return the line about the two maps of an undecided plane, if there are any."""
    if not summary.hypotheses or summary.margin is None:
        return []
    frames = ", ".join(str(keyframe.frame) for keyframe in summary.hypotheses[0].keyframes)
    ahead = summary.margin.log_likelihood
    return [
        ("kept", f"two maps of frames {frames}; the tracks prefer the first by {ahead:.1f} nats"),
        *_risk_facts(summary),
    ]


def _risk_facts(summary: Summary) -> list[tuple[str, str]]:
    """Return the line about the risk of the best map, where a window was judged, and the depths of the landmarks."""
    window = next((attempt.window for attempt in reversed(summary.attempts) if attempt.window is not None), None)
    if window is None:
        return []
    direction = "" if window.direction_sigma_deg is None else f", direction +- {window.direction_sigma_deg:.1f} deg"
    depths = "" if summary.depth_sigma is None else f", depths +- {summary.depth_sigma:.1%}"
    return [("risk", f"{window.risk:.2g} that the map is wrong{direction}{depths}")]


def _map_facts(summary: Summary) -> list[tuple[str, str]]:
    """Return the lines about the map."""
    frames = ", ".join(str(keyframe.frame) for keyframe in summary.keyframes)
    facts = [
        ("keyframes", f"{len(summary.keyframes)} (frames {frames})"),
        *_landmark_facts(summary),
        *_risk_facts(summary),
    ]
    facts += [*_scale_facts(summary), *_gravity_facts(summary)]
    if focal := summary.focal_length:
        if summary.camera.source == "estimated":
            sigma_px = summary.camera.focal_sigma_px or 0.0
            facts.append(("focal length", f"{summary.camera.fx:.0f} +- {sigma_px:.0f} px, estimated from the motion"))
        else:
            adjusted = f"{focal.factor:.3f} +- {focal.factor_sigma:.3f} times the stated one (adjusted)"
            facts.append(("focal length", adjusted))
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
        facts.append(("ground truth", ", ".join(errors) or "too little motion to compare with"))
    return [*facts, *(_segment_fact(segment) for segment in summary.segments)]


def _scale_facts(summary: Summary) -> list[tuple[str, str]]:
    """Return the line about the scale, where one was looked for."""
    scale, sigma, origin = summary.scale, summary.scale_sigma, summary.scale_origin
    if origin is None:
        return []
    if scale is None or sigma is None:
        return [("scale", f"none found from {origin.origin}: {origin.reason}")]
    depth_sigma = summary.depth_sigma or 0.0
    # The scale is that of the baselines. A landmark is as uncertain as its own depth.
    points = f"; the depth of a landmark to +- {depth_sigma:.0%}" if depth_sigma > sigma else ""
    known = f"1 unit = {scale:.4g} m +- {sigma:.1%} ({origin.origin}: {origin.evidence})"
    return [("scale", f"{known}{points}; all results in metres")]


def _gravity_facts(summary: Summary) -> list[tuple[str, str]]:
    """Return the line about gravity, where it was measured."""
    if summary.gravity is None:
        return []
    x, y, z = summary.gravity.down
    return [("gravity", f"down is ({x:.3f}, {y:.3f}, {z:.3f}) in the world, +- {summary.gravity.sigma_deg:.1g} deg")]


def _segment_fact(segment: SegmentRecord) -> tuple[str, str]:
    """Return the line about a map of a run that starts anew after a loss."""
    frames = f"frames {segment.keyframes[0].frame} to {segment.keyframes[-1].frame}"
    end = "followed to the end" if segment.lost_at is None else f"lost at frame {segment.lost_at}"
    scale = "" if segment.scale is None else f", 1 unit = {segment.scale:.4g} m"
    located = f"{segment.continued.located} further frames located"
    return (segment.folder, f"{segment.landmarks} landmarks, {frames}{scale}, {located}, {end}")


def _landmark_facts(summary: Summary) -> list[tuple[str, str]]:
    """Return the lines about the landmarks; none for the map of an external program."""
    if not summary.landmarks:
        return []
    return [
        ("landmarks", f"{summary.landmarks}, {summary.scene} scene"),
        ("parallax", f"{summary.median_parallax_deg:.2f} deg (median)"),
        ("reprojection", f"{summary.reprojection_rmse_px:.2f} px (rms)"),
    ]


def _attempts(summary: Summary) -> str:
    """Return the number of attempts, in total and by verdict."""
    verdicts = Counter(attempt.verdict for attempt in summary.attempts)
    counts = ", ".join(f"{count} {in_words(verdict)}" for verdict, count in verdicts.most_common())
    return f"{len(summary.attempts)}" + (f" ({counts})" if counts else "")
