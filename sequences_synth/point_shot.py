"""One uninterrupted shot of a point world: the path of the camera, the bodies that move, and what each frame sees.

The path is a continuous function of the time, since a rolling shutter sees each pixel at the time of its own row, and
the row is that in which the pixel lies. The projection of a point is therefore a fixed point: of the row, to the time,
to the pose, and to the projected row. The iteration contracts by the rows that the image moves in the time in which one
row is read, at most a few tenths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Bools, Floats, Ints
from sequences_synth.camera import PinholeCamera
from sequences_synth.point_scenes import Layout
from sequences_synth.shutter import Shutter
from sequences_synth.stabilizer import virtual_from_cam
from sequences_synth.trajectory import rotation_from_vector, rotations_from_vectors

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


# -- views -----------------------------------------------------------------------------------------


# A point nearer than this share of the median depth is not visible: it would be out of focus.
_NEAREST = 0.05
# The iteration ends where no pixel moves by more than this. A point that does not converge is not visible: it would be
# seen several times, or not at all.
_CONVERGED_PX = 1e-9
_ITERATIONS = 60


@dataclass(frozen=True, eq=False)
class Views:
    """What one view sees without noise."""

    #: (M, 2) Where the points are seen; meaningless for points that are not visible.
    pixels: Floats
    #: (M,)
    visible: Bools
    #: (M, 2) Motion of the pixels during the exposure.
    smear_px: Floats


@dataclass(frozen=True, eq=False)
class Shot:
    """A camera on its path through a world of points."""

    #: The true camera.
    camera: PinholeCamera
    shutter: Shutter
    path: PointPath
    bodies: Bodies
    #: (M, 3) In the world frame at the first frame, metres.
    points: Floats
    #: Time from one tick to the next.
    interval_s: float
    exposure_s: float
    #: Whether frames are warped to a smoothed path.
    stabilized: bool

    def pose(self, tick: int) -> Floats:
        """Compute the true pose of a frame: of the camera, or of the virtual camera of a stabilized frame.

        Shapes: returns (4, 4).
        """
        pose = self.path.at_frame(tick)
        if self.stabilized:
            pose[:3, :3] = pose[:3, :3] @ self._warp(tick).T
        return pose

    def pixel_poses(self, tick: int, pixels: Floats) -> Floats:
        """Compute the poses that the camera had when it exposed pixels.

        A stabilized frame is warped by one rotation. The pose is then that of the virtual camera: the projection by
        this pose is the pixel in the warped frame.

        Shapes: ``pixels`` (N, 2), returns (N, 4, 4).
        """
        warp = self._warp(tick) if self.stabilized else np.eye(3)
        exposed = self.camera.project(self.camera.rays(pixels) @ warp) if self.stabilized else pixels
        poses = self.path.at(tick + self.shutter.delay_s(exposed) / self.interval_s)
        poses[:, :3, :3] = poses[:, :3, :3] @ warp.T
        return poses

    def see(self, tick: int) -> Views:
        """Project the points."""
        pose = self.path.at_frame(tick)
        X = (self.bodies.displaced(self.points, tick / self.path.last_tick) - pose[:3, 3]) @ pose[:3, :3]
        exposed, ahead = self._project(X)
        ticks = np.full(len(X), float(tick))
        if self.shutter.readout_s > 0:
            exposed, ahead, ticks = self._roll(tick, exposed, ahead)
        pixels, visible = exposed, ahead & self._inside(exposed)
        warp = self._warp(tick) if self.stabilized else np.eye(3)
        if self.stabilized:
            pixels = self._warped(exposed, warp)
            visible = visible & self._inside(pixels)
        smear = np.zeros_like(pixels)
        if self.exposure_s > 0:
            half = 0.5 * self.exposure_s / self.interval_s
            first, last = (self._project(self._cam_points(ticks + side * half))[0] for side in (-1, 1))
            if self.stabilized:
                first, last = self._warped(first, warp), self._warped(last, warp)
            smear = last - first
        return Views(pixels, visible, smear)

    def _roll(self, tick: int, exposed: Floats, ahead: Bools) -> tuple[Floats, Bools, Floats]:
        """Pixels with the shutter, from those without it; which are seen, and when."""
        size = np.array([self.camera.width, self.camera.height], float)
        change = np.full(len(exposed), np.inf)
        for _ in range(_ITERATIONS):
            # A row outside of the image has no time of its own. The bound keeps the iteration finite there.
            ticks = tick + self.shutter.delay_s(np.clip(exposed, -size, 2 * size)) / self.interval_s
            before = exposed
            exposed, ahead = self._project(self._cam_points(ticks))
            change = np.abs(exposed - before).max(axis=1)
            if not (change[ahead & self._inside(exposed)] > _CONVERGED_PX).any():
                break
        return exposed, ahead & (change <= _CONVERGED_PX), ticks

    def _cam_points(self, ticks: Floats) -> Floats:
        """Points in the frame of the camera, each at its own time."""
        poses = self.path.at(ticks)
        X = self.bodies.displaced(self.points, ticks / self.path.last_tick) - poses[:, :3, 3]
        return np.asarray(np.einsum("ni,nij->nj", X, poses[:, :3, :3]))

    def _project(self, X: Floats) -> tuple[Floats, Bools]:
        """Pixels of camera points, and which of these lie before the camera and within its lens."""
        ahead = X[:, 2] > _NEAREST * np.median(np.abs(X[:, 2]))
        X = np.column_stack([X[:, :2], np.where(ahead, X[:, 2], 1.0)])
        if self.camera.k1 < 0:
            ahead &= np.linalg.norm(X[:, :2], axis=1) < self.camera.largest_radius * X[:, 2]
        return self.camera.project(X), ahead

    def _inside(self, pixels: Floats) -> Bools:
        size = np.array([self.camera.width, self.camera.height], float)
        return np.asarray((pixels >= 0).all(axis=1) & (pixels <= size - 1).all(axis=1))

    def _warp(self, tick: int) -> Floats:
        return virtual_from_cam(lambda time_s: self.path.rotation_at(time_s / self.interval_s), tick * self.interval_s)

    def _warped(self, pixels: Floats, warp: Floats) -> Floats:
        """Pixels of the stabilized frame. Those of rays that the virtual camera cannot see are NaN."""
        rays = self.camera.rays(pixels) @ warp.T
        seen = rays[:, 2] > 0
        rays[~seen] = np.nan
        return self.camera.project(rays)
