"""After the initialization: locates the next frames in the map, which tests the map."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slam_init.errors import SourceError
from slam_init.frontend.tracks import Tracker
from slam_init.mapping.triangulation import resect
from slam_init.output.summary import ContinuationRecord
from slam_init.recording.recorder import Recorder
from slam_init.types.frame import Frame
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose

__all__ = ["Continuation", "follow"]

#: A landmark counts as observed again where its track lies within this distance of its projection.
_SURVIVAL_PX = 3.0


@dataclass(frozen=True, eq=False)
class Continuation:
    """Frames located in the map.

    Attributes
    ----------
    keyframes : tuple of Keyframe
        The located frames, world_from_cam; frames that could not be located are missing.
    frames : int
        Number of frames that were looked at.
    survival : tuple of float
        For each of these frames the share of the map's landmarks that it sees within 3 px.
    ended_by : str or None
        Why it ended early: the message of a frame that could not be read.
    """

    keyframes: tuple[Keyframe, ...]
    frames: int
    survival: tuple[float, ...]
    ended_by: str | None = None

    def record(self) -> ContinuationRecord:
        """For ``summary.json``.

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


def follow(
    map_: InitialMap,
    tracker: Tracker,
    frames: Iterator[Frame],
    count: int,
    recorder: Recorder,
) -> Continuation:
    """Resect up to ``count`` further frames with the landmarks of the map, which is not changed.

    Parameters
    ----------
    map_ : InitialMap
    tracker : Tracker
        In its state after the frame at which the map was accepted.
    frames : iterator of Frame
        The frames that follow.
    count : int
        Largest number of frames.
    recorder : Recorder

    Returns
    -------
    Continuation
    """
    camera = map_.camera
    located: list[Keyframe] = []
    survival: list[float] = []
    guess: Pose | None = None
    ended_by: str | None = None
    while len(survival) < count:
        try:
            frame = next(frames, None)
        except SourceError as error:  # the map exists already, and a broken frame must not lose it
            ended_by = str(error)
            break
        if frame is None:
            break
        observed = tracker.track(frame)
        tracker.history.forget(keep=())
        recorder.frame(frame, observed)
        i, j, bearings = map_.seen_in(observed)
        resected = resect(map_.points[i], bearings, _SURVIVAL_PX / camera.focal_px, guess)
        if resected is None:
            survival.append(0.0)
            continue
        guess, _ = resected
        error_px = np.linalg.norm(camera.project(guess.apply(map_.points[i])) - observed.pixels[j], axis=1)
        survival.append(float(np.sum(error_px < _SURVIVAL_PX)) / len(map_.points))
        keyframe = Keyframe(frame.index, frame.timestamp_s, frame.name, guess.inverse())
        located.append(keyframe)
        recorder.continued(keyframe)
    return Continuation(tuple(located), len(survival), tuple(survival), ended_by)
