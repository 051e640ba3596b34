"""Summary of a source (frames, images, camera, ground truth), without running the pipeline."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, TypeAlias

import numpy as np

from slam_init.datasets import TimedSource
from slam_init.datasets.text import TOLERANCE_S
from slam_init.datasets.track_source import TrackSource, TrackTable
from slam_init.errors import plain_line
from slam_init.output.summary import CameraRecord, record
from slam_init.types.camera import Camera
from slam_init.types.frame import notes_of

#: The facts about a source, as ``slam-init info --json`` writes them.
Facts: TypeAlias = dict[str, Any]


def describe(source: TimedSource, camera: Camera | None) -> Facts:
    """Describe a source. The first image is read.

    * ``camera``: Calibration to describe; it may differ from ``source.camera``.
    * Returns: What a source does not have is None: the calibration ``camera``, the true poses ``ground_truth``, the
      ``tracks`` of a source that knows them, and the ``fps`` where all frames have the same time.
    """
    first = next(source.frames(0, 1))
    times_s = source.timestamps_s
    duration_s = float(times_s[-1] - times_s[0])
    return {
        "name": source.name,
        "kind": source.kind,
        "frames": len(source),
        "width": first.image.shape[1],
        "height": first.image.shape[0],
        "color": first.image.ndim == 3,
        "duration_s": round(duration_s, 6),
        "fps": round((len(times_s) - 1) / duration_s, 3) if duration_s > 0 else None,
        "camera": None if camera is None else asdict(record(CameraRecord, camera)),
        "ground_truth": _truth(source),
        "notes": [*notes_of(source), *(camera.notes if camera is not None else ())],
        "tracks": _tracks(source.table) if isinstance(source, TrackSource) else None,
    }


def describe_text(facts: Facts) -> str:
    """Format a description for people, one fact per line."""
    camera, truth, tracks = facts["camera"], facts["ground_truth"], facts["tracks"]
    rate = "" if facts["fps"] is None else f", {facts['duration_s']:.2f} s at {facts['fps']:.3g} frames a second"
    lines = [
        f"{facts['name']} ({facts['kind']})",
        f"  frames        {facts['frames']}{rate}",
        f"  images        {facts['width']}x{facts['height']}, {'colour' if facts['color'] else 'grey'}",
    ]
    if tracks is not None:
        seen = f"{tracks['tracks_per_frame']:.0f} in a frame (median), each in {tracks['frames_per_track']:.1f} frames"
        lines.append(f"  tracks        {tracks['tracks']}, {seen}")
    if camera is None:
        lines.append("  camera        none: give --camera FILE, or --camera auto")
    else:
        sigma_px, lens = camera["focal_sigma_px"], ", ".join(f"{k:.4g}" for k in camera["distortion"])
        known = "" if sigma_px is None else f" (+- {sigma_px:.0f} px, {camera['source']})"
        lines.append(
            "  camera        {model}, f = {fx:.2f}, {fy:.2f}{known}, c = {cx:.2f}, {cy:.2f} px".format(
                known=known, **camera
            )
            + (f", distortion {lens}" if lens else "")
        )
    if truth is None:
        lines.append("  ground truth  none")
    else:
        matched = f"{truth['frames']} of {facts['frames']} frames"
        lines.append(f"  ground truth  for {matched}, path of {truth['path_length']:.3f}")
    lines += [f"  note          {note}" for note in facts["notes"]]
    return "\n".join(plain_line(line) for line in lines) + "\n"


def _tracks(table: TrackTable) -> Facts:
    """The number of tracks, in how many frames one is seen (mean), and how many a frame sees (median)."""
    _, counts = np.unique(table.track_ids, return_counts=True)
    _, seen = np.unique(table.frames, return_counts=True)
    per_track = round(float(counts.mean()), 3)
    return {"tracks": len(counts), "frames_per_track": per_track, "tracks_per_frame": float(np.median(seen))}


def _truth(source: TimedSource) -> Facts | None:
    """How many frames have a true pose, and the length of the path from the first to the last frame in its unit."""
    truth, times_s = source.groundtruth, source.timestamps_s
    if truth is None:
        return None
    within = (truth.timestamps_s >= times_s[0] - TOLERANCE_S) & (truth.timestamps_s <= times_s[-1] + TOLERANCE_S)
    positions = np.array([pose.t for pose, keep in zip(truth.world_from_cam, within, strict=True) if keep])
    steps = np.diff(positions.reshape(-1, 3), axis=0)
    frames = sum(truth.at(float(time_s), TOLERANCE_S) is not None for time_s in times_s)
    return {"frames": frames, "path_length": round(float(np.linalg.norm(steps, axis=1).sum()), 6)}
