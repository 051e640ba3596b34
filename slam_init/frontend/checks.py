"""Checks of what comes from elsewhere: the times of a stream, and the pixels and rays of tracks.

Times are converted to seconds. The rays may have other axes than the project's: x right, y down, z forward.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.history import History, check_lengths
from slam_init.types.time_stamps import LARGEST_SECONDS, TimeUnit, in_seconds, problem_of, time_unit, unit_notes

#: The correction of a rolling shutter moves rays by the turn of the camera during half of a readout: 200 degrees a
#: second over 15 ms. Other axes, or another camera, move the typical ray by more, unless all rays are near the axis.
_LARGEST_MOVE_RAD = np.radians(3.0)
#: Axes of other systems as factors of (x, y, z), and what they are called.
_OTHER_AXES = {
    (1.0, -1.0, -1.0): "those of OpenGL (y up, z backward): multiply y and z by -1",
    (1.0, -1.0, 1.0): "with y up: multiply y by -1",
    (-1.0, -1.0, 1.0): "with x left and y up: multiply both by -1",
    (-1.0, -1.0, -1.0): "the rays from the points to the camera: multiply them by -1",
    (1.0, 1.0, -1.0): "with z backward: multiply z by -1",
}
#: A pixel this many sizes of the image away from it is no measurement of this camera: a lens of 170 degrees has rays at
#: eleven sizes. The polynomials of the fields of correlated errors of all tracks would follow it.
_FARTHEST_SIZES = 20.0


def check_pixels(camera: Camera, frame: int, pixels: Floats) -> None:
    """Raise SlamInitError where pixels are far outside of the image."""
    far = (np.abs(pixels) > _FARTHEST_SIZES * max(camera.width, camera.height)).any(axis=1)
    if far.any():
        worst = np.array2string(pixels[int(np.argmax(far))], precision=3)
        raise SlamInitError(f"frame {frame}: the pixel {worst} is far outside of the image: leave it out")


def check_rays(camera: Camera, current: Observations) -> None:
    """Raise SlamInitError where pixels are far outside of the image, or where bearings are not their rays.

    The message names the axes of such bearings.
    """
    bearings, pixels = current.bearings, current.pixels
    check_lengths(f"frame {current.frame}", bearings)
    check_pixels(camera, current.frame, pixels)
    rays = camera.bearings(pixels)
    known = np.isfinite(rays).all(axis=1)
    if not known.any():
        return
    rays, bearings = rays[known], bearings[known]

    def typical_rad(axes: tuple[float, float, float]) -> float:
        chords = np.linalg.norm(bearings * axes - rays, axis=1)
        return float(np.median(2 * np.arcsin(np.minimum(0.5 * chords, 1.0))))

    if typical_rad((1.0, 1.0, 1.0)) <= _LARGEST_MOVE_RAD:
        return
    name = f"frame {current.frame}"
    for axes, what in _OTHER_AXES.items():
        if typical_rad(axes) <= _LARGEST_MOVE_RAD:
            raise SlamInitError(f"{name}: the bearings are {what} (x right, y down, z forward is expected)")
    raise SlamInitError(f"{name}: the bearings are not the rays of the pixels: give camera.bearings(pixels)")


class FrameClock:
    """Decides the unit of the time stamps of a stream, and checks each stamp.

    The stamps of a stream come one by one, so that its first stamp decides the unit by its size, and the second one by
    the step between them, by the rules of :mod:`slam_init.types.time_stamps`. If the second one decides for another
    unit, the time of the first frame is corrected in the history. From then on the unit stays. A frame of a source has
    seconds already, so that only the size of its stamp counts.

    * ``history``: The frames up to now.
    """

    def __init__(self, history: History) -> None:
        self._history = history
        self._unit = TimeUnit.SECONDS
        # The newest stamps: one may be given back, and then it counts whether there are two.
        self._stamps: deque[float] = deque(maxlen=3)
        self._last_s: float | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        return unit_notes("the time stamps", self._unit)

    def stamped(self, frame: Frame, *, in_seconds_by_type: bool) -> Frame:
        """Check the time stamp of the next frame, and convert it to seconds.

        * ``in_seconds_by_type``: Whether the frame comes from a source or has no time of its own, so that the step
          decides nothing.
        """
        stamp = frame.timestamp_s
        if problem := problem_of(stamp, self._stamps[-1] if self._stamps else None):
            raise SlamInitError(f"frame {frame.index}: time stamp {stamp!r} {problem}")
        if not self._stamps:
            self._unit = time_unit(np.array([stamp]))
        elif len(self._stamps) == 1 and not in_seconds_by_type:
            self._decide_by_step(self._stamps[0], stamp)
        self._stamps.append(stamp)
        return frame if self._unit == TimeUnit.SECONDS else replace(frame, timestamp_s=self._seconds(stamp))

    def give_back(self) -> None:
        """Forget the newest stamp, whose frame was not taken. A unit that it decided stays."""
        self._stamps.pop()

    def check_tracks(self, current: Observations) -> None:
        """Check the time of tracks from elsewhere, which is in seconds."""
        time_s = current.timestamp_s
        problem = problem_of(time_s, self._last_s)
        if problem is None and time_s >= LARGEST_SECONDS:
            problem = "is no time in seconds: divide nanoseconds by 1e9, milliseconds by 1e3"
        if problem is not None:
            raise SlamInitError(f"frame {current.frame}: time stamp {time_s!r} {problem}")

    def took(self, current: Observations) -> None:
        """Remember the time of tracks that were taken."""
        self._last_s = current.timestamp_s

    def _decide_by_step(self, first: float, second: float) -> None:
        unit = time_unit(np.array([first, second]))
        if unit == self._unit:
            return
        self._unit = unit
        for earlier in self._history:
            self._history.put(replace(earlier, timestamp_s=self._seconds(first)))

    def _seconds(self, stamp: float) -> float:
        return float(in_seconds(np.array([stamp]), self._unit)[0])
