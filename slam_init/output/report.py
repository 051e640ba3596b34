"""The summary of a run for a person at a terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["report_text"]


def report_text(summary: Mapping[str, Any], out: Path) -> str:
    """A few aligned lines: what came of the run, how good it is, where the files are.

    Parameters
    ----------
    summary : mapping
        Content of ``summary.json``.
    out : Path
        Folder of the results.
    """
    if summary["status"] == "initialized":
        title, facts = f"initialized after {summary['frames_to_init']} frames", _map_facts(summary)
    else:
        reason = summary["reason"]
        title = f"not initialized: {reason.replace('_', ' ')}"
        facts = [("advice", summary["advice"]), ("frames read", str(summary["frames_read"]))]
        if summary["hypotheses"]:
            frames = ", ".join(str(keyframe["frame"]) for keyframe in summary["hypotheses"][0]["keyframes"])
            margin = summary["margin"]
            facts.append(("kept", f"two maps of frames {frames}; the first ahead by z = {margin['z']:.1f} (4 decide)"))
    facts += [("attempts", _attempts(summary)), *(("note", note) for note in summary["notes"])]
    facts.append(("results", f"{out}/ (recording: rerun {out / 'recording.rrd'})"))
    return f"{title}\n" + "".join(f"  {name:<14}{value}\n" for name, value in facts)


def _map_facts(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    frames = ", ".join(str(keyframe["frame"]) for keyframe in summary["keyframes"])
    facts = [
        ("keyframes", f"{len(summary['keyframes'])} (frames {frames})"),
        ("landmarks", f"{summary['landmarks']}, {summary['scene']} scene"),
        ("parallax", f"{summary['median_parallax_deg']:.2f} deg (median)"),
        ("reprojection", f"{summary['reprojection_rmse_px']:.2f} px (rms)"),
    ]
    if focal := summary.get("focal_length"):
        told = f"{focal['factor']:.3f} +- {focal['factor_sigma']:.3f} times the stated one (adjusted)"
        facts.append(("focal length", told))
    if continued := summary.get("continued"):
        located = f"{continued['located']} of {continued['frames']} further frames located"
        survival = continued["survival_median"]
        seen = "" if survival is None else f", {survival:.0%} of the landmarks seen (median)"
        facts.append(("continued", located + seen))
    truth = summary.get("ground_truth")
    if truth:
        named = (
            ("rotation", "rotation_error_deg", " deg"),
            ("direction", "direction_error_deg", " deg"),
            ("ATE", "ate_rmse", ""),
        )
        errors = [f"{name} {truth[key]:.3g}{unit}" for name, key, unit in named if truth.get(key) is not None]
        facts.append(("ground truth", ", ".join(errors) or "too little motion to compare with"))
    return facts


def _attempts(summary: Mapping[str, Any]) -> str:
    verdicts = Counter(attempt["verdict"] for attempt in summary["attempts"])
    counts = ", ".join(f"{count} {verdict.replace('_', ' ')}" for verdict, count in verdicts.most_common())
    return f"{len(summary['attempts'])}" + (f" ({counts})" if counts else "")
