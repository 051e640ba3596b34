"""Locates the frames after the initialization in the map, as a test of the map."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from slam_init.errors import SourceError
from slam_init.frontend.rolling_shutter import RollingShutter, corrected_pixels
from slam_init.frontend.tracks import History
from slam_init.mapping.resection import resect
from slam_init.output.records import ContinuationRecord
from slam_init.recording.recorder import Recorder
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose

__all__ = ["Continuation", "FrameTracker", "follow"]

#: A landmark counts as observed again where its track lies within this distance of its projection.
_SURVIVAL_PX = 3.0


@dataclass(frozen=True, eq=False)
class Continuation:
    """The frames after the initialization, located in the map.

    Attributes
    ----------
    keyframes : tuple of Keyframe
        The located frames; frames that could not be located are left out.
    frames : int
        Number of frames that were read.
    survival : tuple of float
        For each of these frames, the share of the landmarks that it observes within 3 px of their projection.
    ended_by : str or None
        The message about a frame that could not be read, if this ended the continuation early.
    """

    keyframes: tuple[Keyframe, ...]
    frames: int
    survival: tuple[float, ...]
    ended_by: str | None = None

    def record(self) -> ContinuationRecord:
        """Make the record for ``summary.json``.

        Returns
        -------
        ContinuationRecord
        """
        return ContinuationRecord(
            frames=self.frames,
            located=len(self.keyframes),
            survival_median=float(np.median(self.survival)) if self.survival else None,
            survival_last=self.survival[-1] if self.survival else None,
        )


class FrameTracker(Protocol):
    """Gives the tracks of frames: a :class:`slam_init.frontend.tracks.Tracker`, or a source that knows its tracks."""

    history: History

    def track(self, frame: Frame) -> Observations:
        """Give the tracks of the next frame.

        Parameters
        ----------
        frame : Frame

        Returns
        -------
        Observations
        """
        ...


def follow(
    map_: InitialMap,
    tracker: FrameTracker,
    frames: Iterator[Frame],
    count: int,
    recorder: Recorder,
) -> Continuation:
    """Locate further frames by resection with the landmarks of the map. The map is not changed.

    Parameters
    ----------
    map_ : InitialMap
    tracker : FrameTracker
        That of the initializer, in its state when the map was accepted.
    frames : iterator of Frame
        The frames that follow.
    count : int
        Largest number of frames.
    recorder : Recorder
        Receives a report of each frame.

    Returns
    -------
    Continuation
    """
    camera = map_.camera
    located: list[Keyframe] = []
    survival: list[float] = []
    guess: Pose | None = None
    shutter, rays = RollingShutter(camera), History(2)
    ended_by: str | None = None
    while len(survival) < count:
        try:
            frame = next(frames, None)
        except SourceError as error:  # a frame that cannot be read must not lose the map, which exists already
            ended_by = str(error)
            break
        if frame is None:
            break
        observed = tracker.track(frame)
        tracker.history.forget(keep=())
        recorder.frame(frame, observed)
        rays.put(_by_camera(camera, observed))
        rays.forget(keep=())
        seen = shutter.take(rays, observed.frame)
        _, i, j = np.intersect1d(map_.track_ids, seen.track_ids, return_indices=True)
        resected = resect(map_.points[i], seen.bearings[j], _SURVIVAL_PX / camera.focal_px, guess)
        if resected is None:
            survival.append(0.0)
            continue
        guess, _ = resected
        error_px = np.linalg.norm(
            camera.project(guess.apply(map_.points[i])) - corrected_pixels(camera, seen)[j], axis=1
        )
        survival.append(float(np.sum(error_px < _SURVIVAL_PX)) / len(map_.points))
        keyframe = Keyframe(frame.index, frame.timestamp_s, frame.name, guess.inverse())
        located.append(keyframe)
        recorder.continued(keyframe)
    return Continuation(tuple(located), len(survival), tuple(survival), ended_by)


def _by_camera(camera: Camera, observed: Observations) -> Observations:
    """The tracks of a frame with the rays of another camera, without those that it cannot have seen."""
    bearings = camera.bearings(observed.pixels)
    known = np.isfinite(bearings).all(axis=1)
    return replace(
        observed,
        track_ids=observed.track_ids[known],
        pixels=observed.pixels[known],
        bearings=bearings[known],
        colors=observed.colors[known] if len(observed.colors) else observed.colors,
    )
