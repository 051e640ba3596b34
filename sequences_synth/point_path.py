"""The camera path of a point world, as a continuous function of the time, and the bodies that move in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sequences_synth.point_scenes import Layout
from sequences_synth.trajectory import rotation_from_vector, rotations_from_vectors

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Frequencies of the tremor, periods over the whole path: rotation, translation.
_WAVES = np.array([[1.0, 1.3, 0.8], [1.1, 0.7, 1.4]])
# The tremor of a steady hand: a third of a degree, and a hundredth of the path length.
_SHAKE_RAD, _OFFSET = np.radians(0.3), 0.01


@dataclass(frozen=True, eq=False)
class PointPath:
    """The path of a camera. Its argument is the tick: the time in frame intervals, not necessarily whole."""

    layout: Layout
    #: Unit of the path in metres.
    scale: float
    #: Tick at which the path ends. Rows of the first and last frame lie a little outside.
    last_tick: int
    #: phases_rad, sizes: (2, 3) Tremor of rotation and translation.
    phases_rad: Floats
    sizes: Floats

    def at_frame(self, tick: int) -> Floats:
        """Compute the pose at a frame.

        Shapes: returns (4, 4).
        """
        s = np.array(tick / self.last_tick)
        shake, offset = self._tremor(s)
        pose = np.eye(4)
        pose[:3, :3] = rotation_from_vector(self.layout.rotation(s)) @ rotation_from_vector(shake)
        pose[:3, 3] = self.scale * (self.layout.position(s) + offset * self._moves(np.array(tick)))
        return pose

    def at(self, ticks: Floats) -> Floats:
        """Compute the poses at any times.

        Shapes: ``ticks`` (N,), returns (N, 4, 4).
        """
        s = ticks / self.last_tick
        shake, offset = self._tremor(s)
        # The tremor of the position starts with the translation, from one frame to the next.
        before = np.floor(ticks)
        weight = ticks - before
        moves = (1 - weight) * self._moves(before) + weight * self._moves(before + 1)
        poses = np.tile(np.eye(4), (len(ticks), 1, 1))
        rotations = rotations_from_vectors(self.layout.rotation(s))
        poses[:, :3, :3] = rotations @ rotations_from_vectors(shake) if self.layout.tremor else rotations
        poses[:, :3, 3] = self.scale * (self.layout.position(s) + offset * moves[:, None])
        return poses

    def rotation_at(self, tick: float) -> Floats:
        """Compute the rotation at any time.

        Shapes: returns (3, 3).
        """
        return np.asarray(self.at(np.array([tick]))[0, :3, :3])

    def _tremor(self, s: Floats) -> tuple[Floats, Floats]:
        """Rotation vectors (..., 3) and offsets (..., 3) of the tremor, the latter in units of the path."""
        if not self.layout.tremor:
            return np.zeros((*np.shape(s), 3)), np.zeros((*np.shape(s), 3))
        waves = self.sizes * np.sin(self.phases_rad + 2 * np.pi * s[..., None, None] * _WAVES)
        return _SHAKE_RAD * waves[..., 0, :], _OFFSET * waves[..., 1, :]

    def _moves(self, ticks: Floats) -> Floats:
        """(...) 1 where the camera has left its start, else 0. A camera that does not translate has no such tremor."""
        moves = bool(np.any(self.layout.position(np.array(1.0))))
        gone = np.any(self.layout.position(ticks / self.last_tick), axis=-1)
        return np.asarray(moves * (ticks > 0) * gone, float)


@dataclass(frozen=True, eq=False)
class Bodies:
    """Rigid bodies that translate steadily and turn steadily about their own centres."""

    #: (M,) Number of the body to which a track belongs, -1 where it belongs to none.
    body_of_track: Ints
    #: (B, 3) Translation from the first to the last tick of the path, metres.
    shift: Floats
    #: (B, 3) Rotation vector of the same time.
    turn_rad: Floats
    #: (B, 3) Centre of the turning at the first tick, metres.
    centre: Floats

    def displaced(self, points: Floats, progress: Floats | float) -> Floats:
        """Move the points that lie on bodies.

        Shapes: ``points`` (M, 3), ``progress`` (M,), returns (M, 3).
        """
        X = points.copy()
        moving = np.flatnonzero(self.body_of_track >= 0)
        body = self.body_of_track[moving]
        s = np.asarray(progress)
        share = s[moving, None] if s.ndim else s
        if self.turn_rad.any():
            around = X[moving] - self.centre[body]
            turned = rotations_from_vectors(share * self.turn_rad[body]) @ around[..., None]
            X[moving] = self.centre[body] + turned[..., 0]
        X[moving] += share * self.shift[body]
        return X
