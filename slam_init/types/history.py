"""The observations of the last frames, which every stage reads: tracks, rays, measured rotations and gravity."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.inertial import Gravity, RelativeRotation
from slam_init.types.lens import CurrentLens

#: Rays that were made of unit length in 32 bits are off by some 1e-7. What is off by more was not normalized.
_UNIT_TOLERANCE = 1e-6


def common_tracks(a: Observations, b: Observations) -> tuple[Ints, Ints]:
    """Find the tracks that two frames share.

    Shapes: returns ``i_a, i_b`` (N,).

    * Returns ``i_a, i_b``: Positions of the common tracks in a and in b, in ascending order of the track id.
    """
    _, ia, ib = np.intersect1d(a.track_ids, b.track_ids, assume_unique=True, return_indices=True)
    return ia, ib


class History:
    """Observations of the last frames, and of older ones that are still needed, with the rays of one lens.

    * ``limit``: Number of recent frames that :meth:`forget` keeps in any case.
    * ``lens``: Of all rays. :meth:`slam_init.frontend.rolling_shutter.RollingShutter.change_lens` changes it.
    """

    def __init__(self, camera: Camera, limit: int) -> None:
        self.lens = CurrentLens.of(camera)
        self._limit = limit
        self._frames: dict[int, Observations] = {}
        #: Measured rotations of the frames.
        self.relative_rotations: dict[int, RelativeRotation] = {}
        #: Gravity in the frames that have it, from elsewhere.
        self.gravities: dict[int, Gravity] = {}

    @property
    def camera(self) -> Camera:
        """The camera that the rays are seen through."""
        return self.lens.camera

    @property
    def newest(self) -> int:
        """Absolute index of the newest frame; -1 without one."""
        return max(self._frames, default=-1)

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, frame: int) -> Observations:
        return self._frames[frame]

    def __contains__(self, frame: int) -> bool:
        return frame in self._frames

    def __iter__(self) -> Iterator[Observations]:
        return iter([observations for _, observations in sorted(self._frames.items())])

    def turned(self, frame: int, rotation: Floats, sigma_rad: float) -> None:
        """Take the measured rotation of the newest frame since the frame before.

        Shapes: ``rotation`` (3, 3).
        """
        last = max((one for one in self._frames if one < frame), default=None)
        if last is None:
            return
        before = self.relative_rotations.setdefault(last, RelativeRotation(np.eye(3), 0.0, last))
        self.relative_rotations[frame] = before.after(rotation, sigma_rad)

    def put(self, observations: Observations) -> None:
        """Add a frame, or replace its observations."""
        self._frames[observations.frame] = observations

    def add(self, observations: Observations, revised: Iterable[Observations] = ()) -> None:
        """Check and add the tracks of the next frame, and replace the observations of earlier frames.

        * ``revised``: Earlier frames with additional tracks. Frames that are no longer in the history are ignored.
        """
        for one in (observations, *revised):
            check_lengths(f"frame {one.frame}", one.bearings)
        newest = self.newest
        # A tracker that shares this history has already put its own observations here.
        again = observations.frame == newest and self._frames[newest] is not observations
        if observations.frame < max(newest, 0) or again:
            raise SlamInitError(
                f"frame {observations.frame} is given after frame {newest}: feed frames in ascending order"
            )
        for one in revised:
            if one.frame in self._frames:
                known = self._frames[one.frame]
                self._frames[one.frame] = replace(one, turn_rad_s=known.turn_rad_s, turn_error=known.turn_error)
        self.put(observations)

    def forget(self, keep: Iterable[int]) -> None:
        """Drop all frames but the newest, whose number is the limit, and those to keep besides."""
        wanted = set(keep)
        # Frames are counted, because the indices of a subsampled source are far apart.
        for frame in sorted(self._frames)[: -self._limit]:
            if frame not in wanted:
                self._drop(frame)

    def start_at(self, frame: int) -> None:
        """Drop the frames before a frame."""
        for earlier in [f for f in self._frames if f < frame]:
            self._drop(earlier)

    def _drop(self, frame: int) -> None:
        del self._frames[frame]
        for measured in (self.relative_rotations, self.gravities):
            measured.pop(frame, None)


def check_lengths(name: str, bearings: Floats) -> None:
    """Raise SlamInitError where a finite bearing is not of length 1."""
    # Clipped first: the square of a huge number is not finite.
    misses = np.abs(np.linalg.norm(np.clip(bearings, -2.0, 2.0), axis=1) - 1)
    if len(misses) and float(misses.max()) > _UNIT_TOLERANCE:
        worst = np.array2string(bearings[int(np.argmax(misses))], precision=3)
        raise SlamInitError(
            f"{name}: the bearing {worst} has not the length 1: divide rays by their norm, and leave zero ones out"
        )
