"""Locates the frames after the initialization in the map, which grows meanwhile, until it is lost.

The final map is not changed: :mod:`slam_init.mapping.growing` says how a copy of it grows, and when it
is lost.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slam_init.errors import SlamInitError, SourceError, check_type
from slam_init.mapping.growing import GrowingMap
from slam_init.output.summary import ContinuationRecord
from slam_init.recording.recorder import Recorder
from slam_init.types.frame import Frame, Observations
from slam_init.types.history import History
from slam_init.types.initial_map import InitialMap, Keyframe

#: A growing map holds the last 24 keyframes, and the accepted ones have to be among them.
#: Class: geometry.
_GROWN_KEYFRAMES = 20


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
    #: The map with the keyframes that were added, where it was asked for.
    grown: InitialMap | None = None

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
    #: Earlier frames that got additional tracks with the last one.
    revised: tuple[Observations, ...]

    def track(self, frame: Frame) -> Observations:
        """Give the tracks of the next frame."""
        ...


class Follower:
    """Locates the frames after the initialization in a map, one by one. The map stays, and a copy of it grows.

    Parameters
    ----------
    map_ : InitialMap
    tracker : Tracker
        That of the initializer (:attr:`slam_init.Initializer.tracker`), in its state when the map became final.
    recorder : Recorder, optional
        Receives a report of each frame.

    Attributes
    ----------
    located : list of Keyframe
        The frames that were located.
    survival : list of float
        For each frame, the share of the landmarks of the map that it observes within 3 px of their projection.
    """

    def __init__(self, map_: InitialMap, tracker: FrameTracker, recorder: Recorder | None = None) -> None:
        InitialMap.check(map_)
        if not callable(getattr(tracker, "track", None)):
            raise SlamInitError(f"the tracker is of the type {type(tracker).__name__}: give initializer.tracker")
        self.located: list[Keyframe] = []
        self.survival: list[float] = []
        self._growing, self._count = GrowingMap(map_), len(map_.keyframes)
        self._tracker = tracker
        self._recorder = recorder or Recorder()

    @property
    def lost_at(self) -> int | None:
        """Absolute index of the first frame in which the map was lost; None while it is not."""
        return self._growing.lost_at

    @property
    def keyframes(self) -> int:
        """Number of keyframes of the map as it has grown."""
        return self._count + self._growing.keyframes_added

    @property
    def map(self) -> InitialMap:
        """The map as it has grown."""
        return self._growing.grown()

    def locate(self, frame: Frame) -> Keyframe | None:
        """Locate the next frame.

        Parameters
        ----------
        frame : Frame
            Of a source, or ``Frame(index, timestamp_s, name, image)``. The frames are in ascending order.

        Returns
        -------
        Keyframe or None
            The frame with its pose ``world_from_cam``; None where it could not be located.

        Raises
        ------
        SlamInitError
            If this is no frame of the camera, or does not come after the last one.
        """
        check_type(frame, Frame, "the frame", "Frame(index, timestamp_s, name, image)")
        newest = self._tracker.history.newest
        if frame.index <= newest:
            raise SlamInitError(f"frame {frame.index} is given after frame {newest}: feed frames in ascending order")
        observed = self._tracker.track(frame)
        self._tracker.history.forget(keep=())
        self._recorder.frame(frame, observed)
        located = self._growing.locate(observed, self._tracker.revised)
        self.survival.append(0.0 if located is None else located.survival)
        if located is None:
            return None
        self.located.append(located.keyframe)
        self._recorder.continued(located.keyframe)
        return located.keyframe


def follow(
    map_: InitialMap,
    tracker: FrameTracker,
    frames: Iterator[Frame],
    count: int | None,
    recorder: Recorder,
    *,
    until_lost: bool = False,
    keep_grown: bool = False,
) -> Continuation:
    """Locate further frames by resection with the landmarks of the map. The map is not changed; a copy grows.

    * ``tracker``: That of the initializer, in its state when the map was accepted.
    * ``until_lost``: Whether to end where the map is lost. The frames from there on are then not located.
    * ``keep_grown``: Whether to return the grown map, as it is with 20 keyframes or at the end.
    """
    follower = Follower(map_, tracker, recorder)
    ended_by: str | None = None
    grown: InitialMap | None = None
    try:
        for frame in itertools.islice(frames, count):
            follower.locate(frame)
            if keep_grown and grown is None and follower.keyframes >= _GROWN_KEYFRAMES:
                grown = follower.map
            if until_lost and follower.lost_at is not None:
                break
    except SourceError as error:  # a frame that cannot be read must not lose the map, which exists already
        ended_by = str(error)
    lost_at = follower.lost_at if until_lost else None
    located = [keyframe for keyframe in follower.located if lost_at is None or keyframe.frame < lost_at]
    if keep_grown and grown is None and follower.lost_at is None:
        grown = follower.map
    return Continuation(tuple(located), len(follower.survival), tuple(follower.survival), ended_by, lost_at, grown)
