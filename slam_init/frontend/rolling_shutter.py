"""The rolling shutter: each row of an image is taken at its own time, while the camera turns.

A pixel in row y of an image of height h is taken ``readout ((y + 1/2) / h - 1/2)`` after the middle row. In column x of
an image of width w it is ``readout ((x + 1/2) / w - 1/2)`` after the middle column, where columns are read one after
the other (a phone that is held upright). The pose of a frame, and its time stamp, are those of the middle.

Most of what an image moves in so short a time is the turning of the camera, and the tracks of neighbouring frames show
how it turns (a visual gyroscope). So a ray is turned back to the middle of the readout. The readout is one number of
the camera. Where it is not known, the window estimates it (:mod:`slam_init.window`). It is counted along the axis that
the camera states (:attr:`slam_init.types.camera.Camera.readout_axis`): an estimate in the other direction is negative.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quest.geometry.quaternion import vector_from_rotation
from quest.robust.rotation import refine_rotation
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.history import History, common_tracks
from slam_init.types.lens import CurrentLens

#: A hand changes its turning several times in a second. With frames farther apart than this, the turning between two
#: frames has no information about the turning in the time of a readout.
VIDEO_INTERVAL_S = 0.15
#: A hand swings a camera at up to 0.8 Hz, so its turning changes by about five times itself in a second. The turning of
#: a single step is that at its middle, and both frames are half a step away from it.
_SWING_PER_S = 5.0
#: Least number of tracks of a turning.
_LEAST_TRACKS = 8
#: Scales of the robust kernel that aligns two frames by a rotation. The last one is wide (half a degree), so that the
#: parallax of a translation averages out.
_SCALES_RAD = (0.1, 0.03, 0.01)
#: Readouts that differ by less move no pixel by a tenth where the camera turns at 100 deg/s: 0.2 ms.
_SAME_READOUT_S = 2e-4


def turning_flow(camera: Camera, rays: Floats, turns_rad_s: Floats) -> Floats:
    """How pixels move by the turning of the camera.

    Times :func:`readout_places` this is the derivative of the raw pixels by the readout.

    Shapes: ``rays`` (N, 3), ``turns_rad_s`` (N, 3) or (3,), returns (N, 2).
    """
    return camera.moved_pixels(rays, np.cross(turns_rad_s, rays))


def corrected_pixels(camera: Camera, observations: Observations) -> Floats:
    """The raw pixels of a frame as they would be if all rows were taken at the time of the middle one.

    Shapes: returns (N, 2).
    """
    if observations.turn_rad_s is None or observations.readout_s == 0.0:
        return observations.pixels
    return camera.project(observations.bearings)


class RollingShutter:
    """Corrects the rays of the frames of a video.

    * ``camera``: Its readout is used; where it is unknown, the rays are corrected once :meth:`adopt` gets an
      estimate. The lens is that of the history.
    * ``readout_s``: Readout that the rays are corrected for.
    """

    def __init__(self, camera: Camera) -> None:
        self.readout_s = camera.readout_s or 0.0
        self._off = camera.readout_s == 0.0
        self._newest: int | None = None
        self._steps: list[_Step] = []

    def correct_newest(self, history: History, frame: int) -> Observations:
        """Find how the camera turns in the two newest frames of a history, and correct their rays there.

        * ``frame``: The newest one. It is returned as it is in the history now.
        """
        if self._off:
            return history[frame]
        # Frames that got more tracks have raw rays again.
        self._correct_all(history)
        current = history[frame]
        previous = history[self._newest] if self._newest is not None and self._newest in history else None
        self._newest = frame
        step = None if previous is None else self._step(history.camera, previous, current)
        self._steps = [] if step is None else [*self._steps[-1:], step]
        if step is None or previous is None:
            return current
        error = 0.0
        if len(self._steps) == 1:
            turns = {previous.frame: step.turn_rad_s, frame: step.turn_rad_s}
            error = 0.5 * _SWING_PER_S * step.length_s
        else:
            first, last = self._steps
            # The turning of a step is that at its middle. It changes linearly from there to the middle of the next.
            change = (last.turn_rad_s - first.turn_rad_s) / (first.length_s + last.length_s)
            between = first.turn_rad_s + change * first.length_s
            turns = {previous.frame: between, frame: last.turn_rad_s + change * last.length_s}
            if first.is_first:
                turns[first.frame] = first.turn_rad_s - change * first.length_s
        for one, turn_rad_s in turns.items():
            if one in history:
                corrected = self.corrected(history.camera, history[one], turn_rad_s)
                history.put(replace(corrected, turn_error=error))
        return history[frame]

    def _step(self, camera: Camera, previous: Observations, current: Observations) -> _Step | None:
        """The turning between two frames; None where they are far apart in time, or share too few tracks."""
        length_s = current.timestamp_s - previous.timestamp_s
        if not 0 < length_s <= VIDEO_INTERVAL_S:
            return None
        i, j = common_tracks(previous, current)
        if len(i) < _LEAST_TRACKS:
            return None
        if self._steps:
            current = self.corrected(camera, current, self._steps[-1].turn_rad_s)
        R = refine_rotation(np.eye(3), previous.bearings[i], current.bearings[j], *_SCALES_RAD, iterations=4)
        return _Step(vector_from_rotation(R) / length_s, length_s, previous.frame, not self._steps)

    def adopt(self, history: History, readout_s: float) -> bool:
        """Correct all frames of a history for another readout.

        * Returns: Whether the frames were changed: not for nearly the same readout.
        """
        if abs(readout_s - self.readout_s) <= _SAME_READOUT_S:
            return False
        self.readout_s = readout_s
        self._correct_all(history)
        return True

    def change_lens(self, history: History, lens: CurrentLens) -> None:
        """Go on with another lens: the history gets the rays of all its frames again."""
        if lens is history.lens:
            return
        # The turning was seen through the earlier lens: a longer one sees the same motion of the pixels as less.
        camera, shorter = lens.camera, history.camera.focal_px / lens.camera.focal_px
        history.lens = lens
        self._steps = [replace(step, turn_rad_s=shorter * step.turn_rad_s) for step in self._steps]
        for one in history:
            turn = None if one.turn_rad_s is None else shorter * one.turn_rad_s
            raw = replace(one.through(camera), turn_rad_s=turn)
            history.put(raw if turn is None or self._off else self.corrected(camera, raw, turn))

    def _correct_all(self, history: History) -> None:
        for one in history:
            if one.turn_rad_s is not None and one.readout_s != self.readout_s:
                # Both corrections turn about the same axis.
                rest_s = one.readout_s - self.readout_s
                bearings = _turned(history.camera, one, one.bearings, one.turn_rad_s, rest_s)
                history.put(replace(one, bearings=bearings, readout_s=self.readout_s))

    def corrected(self, camera: Camera, observations: Observations, turn_rad_s: Floats) -> Observations:
        """The tracks of a frame with their rays at the middle of the readout.

        Shapes: ``turn_rad_s`` (3,).
        """
        raw = observations.bearings
        if observations.turn_rad_s is not None and observations.readout_s:
            raw = _turned(camera, observations, raw, observations.turn_rad_s, observations.readout_s)
        bearings = _turned(camera, observations, raw, turn_rad_s, -self.readout_s) if self.readout_s else raw
        return replace(observations, bearings=bearings, turn_rad_s=turn_rad_s, readout_s=self.readout_s)


@dataclass(frozen=True, eq=False)
class _Step:
    """The turning of the camera between two frames."""

    #: (3,)
    turn_rad_s: Floats
    length_s: float
    #: Absolute index of the earlier frame.
    frame: int
    #: Whether no step ends at the earlier frame, so that its turning is that of this step.
    is_first: bool


def readout_places(camera: Camera, pixels: Floats) -> Floats:
    """Places of pixels in the order of the readout.

    Shapes: ``pixels`` (..., 2).
    """
    return np.asarray(((pixels + 0.5) / (camera.width, camera.height) - 0.5) @ camera.readout_axis)


def _turned(
    camera: Camera, observations: Observations, bearings: Floats, turn_rad_s: Floats, readout_s: float
) -> Floats:
    """Rays (N, 3) that turn with the camera for the time between the middle and their own place."""
    speed = float(np.linalg.norm(turn_rad_s))
    axis = turn_rad_s / max(speed, 1e-300)
    angles = (readout_places(camera, observations.pixels) * (readout_s * speed))[:, None]
    # The formula of Rodrigues for one axis and many angles, without a matrix for each ray.
    x, y, z = bearings.T
    across = np.column_stack([axis[1] * z - axis[2] * y, axis[2] * x - axis[0] * z, axis[0] * y - axis[1] * x])
    along = (bearings @ axis)[:, None] * axis
    return np.asarray(along + np.cos(angles) * (bearings - along) + np.sin(angles) * across)
