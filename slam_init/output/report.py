"""The report of a run as text: at its end that of its result with what only the run knows; later that of its folder.

A folder is read from its files alone. It may come from another machine: it is read within bounds, and a file that is
not what it should be is an error of one line.
"""

from __future__ import annotations

import json
import math
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from quest.display import aligned
from slam_init.errors import SourceError, plain_line
from slam_init.output.folder import read_marker
from slam_init.output.names import RECORDING, RUN_FILES
from slam_init.output.summary import SegmentRecord, Summary
from slam_init.system.regular_file import check_inside, read_regular
from slam_init.types.initial_map import risk_in_words
from slam_init.types.refusal import in_words
from slam_init.types.result import Result, report_facts

_SUMMARY = "summary.json"
#: A thousand attempts with their gates and evidence have 4 MB.
_LIMIT_BYTES = 64_000_000
#: More keyframes are cut in the text, never in the facts.
_SHOWN_KEYFRAMES = 20
#: Depths of a larger median deviation are worth a hint: splats and depth maps need a tenth.
_UNCERTAIN_DEPTHS = 0.1


def report_text(result: Result, summary: Summary, out: str | os.PathLike[str], replaced: str | None = None) -> str:
    """Write a few aligned lines: the verdict, the quality of the map, and the folder of the results.

    * ``replaced``: The earlier result that was in the folder.
    """
    title, facts = report_facts(result, _run_facts(summary))
    folder = plain_line(str(Path(out)))
    if replaced is not None:
        facts = [*facts, ("replaced", plain_line(replaced))]
    facts = [*facts, ("results", f"{folder}/ (look at overview.png, or: slam-init view {folder})")]
    # The map of a run without --refine ends with the frame that it was accepted at.
    ended = result.frames_read == result.frames_to_init
    if ended and result.map is not None and result.map.depth_sigma > _UNCERTAIN_DEPTHS:
        facts.append(("next", "--refine 30 lets the map grow, for better depths"))
    return aligned(title, facts) + "\n"


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
            ("ATE", truth.ate_rmse and 100 * truth.ate_rmse / truth.path_length, "% of the path"),
        )
        errors = [f"{name} {value:.3g}{unit}" for name, value, unit in named if value is not None]
        if truth.scale_error is not None:
            errors.append(f"scale {truth.scale_error:+.1%}")
        known, error, sigma = "", truth.direction_error_deg, truth.true_direction_sigma_deg
        # The accuracy of the ground truth explains the error: within two deviations.
        if error is not None and sigma is not None and sigma >= 1 and error <= 2 * sigma:
            baseline = f"baseline of {100 * (truth.true_baseline or 0.0):.2g} cm"
            known = f"; the true direction is known to about {sigma:.2g} deg ({baseline})"
        facts.append(("ground truth", ", ".join(errors) + known or "too little motion to compare with"))
    return [*facts, *(_segment_fact(segment) for segment in summary.segments)]


def _segment_fact(segment: SegmentRecord) -> tuple[str, str]:
    """Return the line about a map of a run that restarts after a loss."""
    frames = f"frames {segment.keyframes[0].frame} to {segment.keyframes[-1].frame}"
    end = "followed to the end" if segment.lost_at is None else f"lost at frame {segment.lost_at}"
    scale = "" if segment.scale is None else f", 1 unit = {segment.scale:.4g} m"
    located = f"{segment.continued.located} further frames located"
    return (segment.folder, f"{segment.landmarks} landmarks, {frames}{scale}, {located}, {end}")


def is_result_folder(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is a folder that ``slam-init run`` wrote, or a copy of one.

    * Returns: True for a folder with the marker of a run. A copy may lack the marker: then there are a summary, and the
      resolved configuration or the recording beside it.
    """
    folder = Path(path)
    try:
        if (marker := read_marker(folder)) is not None:
            return marker.command == "run"
        others = ("config.toml", RECORDING)
        return (folder / _SUMMARY).is_file() and any((folder / name).is_file() for name in others)
    except Exception:  # a name that the system does not take, or a damaged marker: the readers report it
        return False


def earlier_result(folder: Path) -> str | None:
    """Name the result that a run will replace; None where there is none."""
    with suppress(SourceError):
        if is_result_folder(folder):
            facts = read_result(folder)
            return f"the result of {facts['source'] or 'an earlier run'}, {_outcome(facts)}"
    return None


def read_result(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a folder of results.

    * Returns: The facts in the order of ``slam-init info --json``. The risk is that of the last evaluated window.
    """
    folder = Path(path)
    summary = _read_summary(folder)
    there = [name for name in RUN_FILES if (folder / name).is_file() and not (folder / name).is_symlink()]
    try:
        provenance = summary.get("provenance") or {}
        windows = [window for attempt in summary["attempts"] if (window := attempt.get("window"))]
        risk = windows[-1]["risk"] if windows else None
        return {
            "folder": str(folder),
            "status": summary["status"],
            "reason": summary.get("reason"),
            "advice": summary.get("advice", ""),
            "risk": risk if risk is None or math.isfinite(risk) else None,
            "source": summary.get("source", {}).get("name", ""),
            **{key: summary[key] for key in ("method", "seed", "frames_read", "frames_to_init")},
            "keyframes": [int(keyframe["frame"]) for keyframe in summary["keyframes"]],
            "landmarks": summary["landmarks"],
            "hypotheses": len(summary["hypotheses"]),
            "attempts": len(summary["attempts"]),
            "files": [{"name": name, "bytes": (folder / name).stat().st_size} for name in there],
            "version": provenance.get("packages", {}).get("slam-init"),
            "command": [str(word) for word in provenance.get("command", ())],
            "notes": [str(note) for note in summary.get("notes", ())],
            "wrong_focal": summary.get("wrong_focal"),
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SourceError(f"{folder / _SUMMARY} is damaged ({error}): run again") from None


def result_text(facts: dict[str, Any]) -> str:
    """Format the facts of a folder of results for people, one per line."""
    lines = [("advice", facts["advice"])]
    if not facts["reason"]:
        frames = facts["keyframes"]
        shown = ", ".join(map(str, frames[:_SHOWN_KEYFRAMES])) + (", ..." if len(frames) > _SHOWN_KEYFRAMES else "")
        lines = [("keyframes", f"{len(frames)} (frames {shown})"), ("landmarks", str(facts["landmarks"]))]
    if facts["hypotheses"]:
        lines.append(("kept", f"{facts['hypotheses']} maps, one of them is right"))
    lines += [] if facts["risk"] is None else [("risk", risk_in_words(facts["risk"]))]
    lines += [
        ("source", facts["source"]),
        ("method", f"{facts['method']}, seed {facts['seed']}, {facts['attempts']} attempts"),
        ("version", facts["version"] or "unknown"),
        ("command", " ".join(facts["command"]) or "unknown"),
        *(("note", note) for note in facts["notes"]),
        *(("" if k else "files", f"{one['name']}  {_size(one['bytes'])}") for k, one in enumerate(facts["files"])),
    ]
    title = plain_line(f"{facts['folder']}: {_outcome(facts)}")
    return aligned(title, [(name, plain_line(text)) for name, text in lines]) + "\n"


def _outcome(facts: dict[str, Any]) -> str:
    if facts["reason"] is None:
        return f"initialized after {facts['frames_to_init']} frames"
    return f"not initialized after {facts['frames_read']} frames: {in_words(facts['reason'])}"


def _read_summary(folder: Path) -> dict[str, Any]:
    path = folder / _SUMMARY
    check_inside(path, folder)
    if not path.exists():
        raise SourceError(f"{folder} holds no {_SUMMARY}: the run was interrupted, or is not complete; run again")
    data = read_regular(path, _LIMIT_BYTES, "the summary of a run", SourceError)
    try:
        summary = json.loads(data)
        assert isinstance(summary, dict)
    except (ValueError, RecursionError, AssertionError):
        raise SourceError(f"{path} is damaged: run again") from None
    return summary


def _size(count: int) -> str:
    for unit, scale in (("MB", 1_000_000), ("kB", 1000)):
        if count >= scale:
            return f"{count / scale:.1f} {unit}"
    return f"{count} bytes"
