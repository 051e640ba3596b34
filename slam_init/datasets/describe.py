"""Summary of a source (frames, images, camera, ground truth), without running the pipeline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_init.datasets import TimedSource
from slam_init.datasets.match_chains import TrackTable
from slam_init.datasets.track_source import TrackSource
from slam_init.errors import plain_line
from slam_init.output.records import CameraRecord, record
from slam_init.types.camera import Camera
from slam_init.types.frame import notes_of

# A true pose belongs to a frame if their time stamps differ by no more than this.
_TOLERANCE_S = 0.02


@dataclass(frozen=True)
class TruthDescription:
    """The ground truth of a source."""

    #: Number of frames that have a true pose.
    frames: int
    #: Length of the true trajectory between the first and the last frame, in the unit of the ground truth.
    path_length: float


@dataclass(frozen=True)
class TracksDescription:
    """The tracks of a source that knows them."""

    #: Number of tracks.
    tracks: int
    #: Mean number of frames in which a track is seen.
    frames_per_track: float
    #: Median number of tracks that are seen in a frame.
    tracks_per_frame: float


@dataclass(frozen=True)
class SourceDescription:
    """The facts about a source, in the order of the output of ``slam-init info --json``."""

    name: str
    #: Format of the source, for example ``tum``.
    kind: str
    #: Number of frames.
    frames: int
    #: width, height: Size of the first image in pixels.
    width: int
    height: int
    #: Whether the first image has colours.
    color: bool
    #: Time from the first to the last frame in seconds.
    duration_s: float
    #: Frames per second; None if all frames have the same time.
    fps: float | None
    #: None if the source has no calibration.
    camera: CameraRecord | None
    #: None if the source has no ground truth.
    ground_truth: TruthDescription | None
    #: What the user should know about the source, for example the unit of its time stamps.
    notes: tuple[str, ...] = ()
    #: None if the source gives images alone.
    tracks: TracksDescription | None = None


def describe(source: TimedSource, camera: Camera | None) -> SourceDescription:
    """Describe a source. The first image is read.

    * ``camera``: Calibration to describe; it may differ from ``source.camera``.
    """
    first = next(source.frames(0, 1))
    times_s = source.timestamps_s
    duration_s = float(times_s[-1] - times_s[0])
    return SourceDescription(
        name=source.name,
        kind=source.kind,
        frames=len(source),
        width=first.image.shape[1],
        height=first.image.shape[0],
        color=first.image.ndim == 3,
        duration_s=round(duration_s, 6),
        fps=round((len(times_s) - 1) / duration_s, 3) if duration_s > 0 else None,
        camera=None if camera is None else record(CameraRecord, camera),
        ground_truth=_describe_truth(source),
        notes=(*notes_of(source), *(camera.notes if camera is not None else ())),
        tracks=_describe_tracks(source.table) if isinstance(source, TrackSource) else None,
    )


def describe_text(info: SourceDescription) -> str:
    """Format a description for people, one fact per line."""
    camera, truth = info.camera, info.ground_truth
    rate = "" if info.fps is None else f", {info.duration_s:.2f} s at {info.fps:.3g} frames a second"
    lines = [
        f"{info.name} ({info.kind})",
        f"  frames        {info.frames}{rate}",
        f"  images        {info.width}x{info.height}, {'colour' if info.color else 'grey'}",
    ]
    if info.tracks is not None:
        seen, length = info.tracks.tracks_per_frame, info.tracks.frames_per_track
        lines.append(
            f"  tracks        {info.tracks.tracks}, {seen:.0f} in a frame (median), each in {length:.1f} frames"
        )
    if camera is None:
        lines.append("  camera        none: give --camera FILE, or --camera auto")
    else:
        known = "" if camera.focal_sigma_px is None else f" (+- {camera.focal_sigma_px:.0f} px, {camera.source})"
        lens = ", ".join(f"{k:.4g}" for k in camera.distortion)
        lines.append(
            f"  camera        {camera.model}, "
            f"f = {camera.fx:.2f}, {camera.fy:.2f}{known}, c = {camera.cx:.2f}, {camera.cy:.2f} px"
            + (f", distortion {lens}" if lens else "")
        )
    if truth is None:
        lines.append("  ground truth  none")
    else:
        matched = f"{truth.frames} of {info.frames} frames"
        lines.append(f"  ground truth  for {matched}, path of {truth.path_length:.3f}")
    lines += [f"  note          {note}" for note in info.notes]
    return "\n".join(plain_line(line) for line in lines) + "\n"


def _describe_tracks(table: TrackTable) -> TracksDescription:
    _, counts = np.unique(table.track_ids, return_counts=True)
    _, seen = np.unique(table.frames, return_counts=True)
    return TracksDescription(len(counts), round(float(counts.mean()), 3), float(np.median(seen)))


def _describe_truth(source: TimedSource) -> TruthDescription | None:
    truth, times_s = source.groundtruth, source.timestamps_s
    if truth is None:
        return None
    within = (truth.timestamps_s >= times_s[0] - _TOLERANCE_S) & (truth.timestamps_s <= times_s[-1] + _TOLERANCE_S)
    positions = np.array([pose.t for pose, keep in zip(truth.world_from_cam, within, strict=True) if keep])
    steps = np.diff(positions.reshape(-1, 3), axis=0)
    return TruthDescription(
        frames=sum(truth.at(float(time_s), _TOLERANCE_S) is not None for time_s in times_s),
        path_length=round(float(np.linalg.norm(steps, axis=1).sum()), 6),
    )
