"""Locates the frames after the initialization in the map: as a test of the map, or until the map is lost.

The map is not changed, and it gets no new landmarks. The tracker follows the tracks of its landmarks, and each frame is
located by resection. A track that is lost does not come back, so that the number of landmarks falls while the camera
leaves the part of the scene that the map shows. The map is lost where fewer than ``min_resected`` tracks of landmarks
are left, or where no pose agrees with that many landmarks in five frames in a row. The first of these frames is the one
from which a new map may begin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from slam_init.config import MapConfig
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

#: A landmark counts as observed again where its track lies within this distance of its projection.
_SURVIVAL_PX = 3.0
#: A blur or a flash of a sixth of a second loses no map whose tracks go on after it.
_LOST_AFTER = 5


@dataclass(frozen=True, eq=False)
class Continuation:
    """The frames after the initialization, located in the map."""

    #: The located frames; frames that could not be located are left out.
    keyframes: tuple[Keyframe, ...]
    #: Number of frames that were read.
    frames: int
    #: For each of these frames, the share of the landmarks that it observes within 3 px of their projection.
    survival: tuple[float, ...]
    #: The message about a frame that could not be read, if this ended the continuation early.
    ended_by: str | None = None
    #: Absolute index of the first frame in which the map was lost, if this ended the continuation.
    lost_at: int | None = None

    def record(self) -> ContinuationRecord:
        """Make the record for ``summary.json``."""
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
        """Give the tracks of the next frame."""
        ...


class Follower:
    """Locates frames one by one.

    * ``tracker``: That of the initializer, in its state when the map was accepted.
    * ``recorder``: Receives a report of each frame.
    * ``located``: The frames that were located.
    * ``survival``: For each frame, the share of the landmarks that it observes within 3 px of their projection.
    * ``lost_at``: Absolute index of the first frame in which the map was lost; None while it is not.
    """

    def __init__(self, map_: InitialMap, tracker: FrameTracker, recorder: Recorder | None = None) -> None:
        self.located: list[Keyframe] = []
        self.survival: list[float] = []
        self.lost_at: int | None = None
        self._map = map_
        self._tracker = tracker
        self._recorder = recorder or Recorder()
        self._shutter, self._rays = RollingShutter(map_.camera), History(2)
        self._guess: Pose | None = None
        self._misses: list[int] = []
        self._least = MapConfig().min_resected

    def locate(self, frame: Frame) -> Keyframe | None:
        """Locate the next frame."""
        camera, map_ = self._map.camera, self._map
        observed = self._tracker.track(frame)
        self._tracker.history.forget(keep=())
        self._recorder.frame(frame, observed)
        self._rays.put(_by_camera(camera, observed))
        self._rays.forget(keep=())
        seen = self._shutter.correct(self._rays, observed.frame)
        _, i, j = np.intersect1d(map_.track_ids, seen.track_ids, return_indices=True)
        resected = resect(map_.points[i], seen.bearings[j], _SURVIVAL_PX / camera.focal_px, self._guess)
        self._judge(frame.index, len(i), 0 if resected is None else int(resected[1].sum()))
        if resected is None:
            self.survival.append(0.0)
            return None
        self._guess = resected[0]
        error_px = np.linalg.norm(
            camera.project(self._guess.apply(map_.points[i])) - corrected_pixels(camera, seen)[j], axis=1
        )
        self.survival.append(float(np.sum(error_px < _SURVIVAL_PX)) / len(map_.points))
        keyframe = Keyframe(frame.index, frame.timestamp_s, frame.name, self._guess.inverse())
        self.located.append(keyframe)
        self._recorder.continued(keyframe)
        return keyframe

    def _judge(self, frame: int, tracked: int, agreeing: int) -> None:
        """Find out whether the map is lost."""
        self._misses = [] if agreeing >= self._least else [*self._misses, frame]
        if tracked < self._least or len(self._misses) >= _LOST_AFTER:
            self.lost_at = min([frame, *self._misses]) if self.lost_at is None else self.lost_at


def follow(
    map_: InitialMap,
    tracker: FrameTracker,
    frames: Iterator[Frame],
    count: int | None,
    recorder: Recorder,
    *,
    until_lost: bool = False,
) -> Continuation:
    """Locate further frames by resection with the landmarks of the map. The map is not changed.

    * ``tracker``: That of the initializer, in its state when the map was accepted.
    * ``until_lost``: Whether to end where the map is lost. The frames from there on are then not located.
    """
    follower = Follower(map_, tracker, recorder)
    ended_by: str | None = None
    while count is None or len(follower.survival) < count:
        try:
            frame = next(frames, None)
        except SourceError as error:  # a frame that cannot be read must not lose the map, which exists already
            ended_by = str(error)
            break
        if frame is None:
            break
        follower.locate(frame)
        if until_lost and follower.lost_at is not None:
            break
    lost_at = follower.lost_at if until_lost else None
    located = [keyframe for keyframe in follower.located if lost_at is None or keyframe.frame < lost_at]
    return Continuation(tuple(located), len(follower.survival), tuple(follower.survival), ended_by, lost_at)


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
