"""A motion of the camera through the views of a window, and its joint fit.

Warm start: a window differs from the one before it by a frame, so the answer of its fit is near that of the last fit. A
start from measured rays and linear triangulation would need a dozen steps to come there again. The points are
homogeneous, so that points at infinity are kept too.

Rolling shutter: the turning of the camera is known for each frame (:mod:`slam_init.frontend.rolling_shutter`). It was
found as the rotation between neighbouring frames that aligns all tracks best, so it contains what a rotation can
explain of the parallax. What the parallax of a single track differs from that depends on its distance and on the
velocity of the camera. Both are known once a window has been fitted. With the velocity ``v`` of the points in the
camera frame and the inverse distance ``rho`` along the unit ray ``d``, the ray moves by ``rho v`` and the best rotation
by ``m`` ::

    m = (sum (I - d d^T))^-1  sum rho d x v
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from quest.geometry.quaternion import rotation_angle
from slam_init.frontend.rolling_shutter import readout_places
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.lens import SAME_LENS, Lens
from slam_init.types.pose import Pose
from slam_init.window.arguments import Limits
from slam_init.window.joint_fit import LIMITS, JointFit, fit_window, start_noise_factor
from slam_init.window.levels import NEAR_DIRECTION_DEG, NEAR_ROTATION_DEG, SAME_DIRECTION_DEG, SAME_ROTATION_DEG
from slam_init.window.state import Priors, WindowState, start_at
from slam_init.window.tracks import WindowTracks

#: A point at infinity is put at this many median distances where a point is needed: a baseline moves it by less than
#: a ten thousandth of the median parallax.
_FAR = 1e4
#: Least number of tracks of a view: three directions determine a rotation.
_LEAST_TRACKS = 3


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of the camera through some frames."""

    #: By absolute frame index; the world is any frame of reference.
    cam_from_world: dict[int, Pose]
    #: (3,) ``plane . X = 1`` in the world, where most points lie on one plane.
    plane: Floats | None = None
    lens: Lens = SAME_LENS
    #: Where the last fit of the motion ended; None before its first fit.
    points: WarmStart | None = None
    #: Whether the motion has not been carried from one window to the next.
    is_new: bool = True

    def known_in(self, tracks: WindowTracks) -> dict[int, Pose]:
        """The poses of the views of a window that the motion knows, by row."""
        frames = enumerate(tracks.frames)
        return {row: self.cam_from_world[frame] for row, frame in frames if frame in self.cam_from_world}

    def is_near(self, other: Motion) -> bool:
        """Whether another motion moves the first two frames alike, so that a fit ends in the same optimum."""
        first, second = list(self.cam_from_world)[:2]
        if first not in other.cam_from_world or second not in other.cam_from_world:
            return False
        a, b = (one.cam_from_world[second] @ one.cam_from_world[first].inverse() for one in (self, other))
        rotation_deg, direction_deg = difference_deg(a, b)
        return rotation_deg <= NEAR_ROTATION_DEG and direction_deg <= NEAR_DIRECTION_DEG


@dataclass(frozen=True, eq=False)
class FittedMotion:
    """A motion with the joint fit of the views that it could locate."""

    fit: JointFit
    #: Views of the window in the fit, reference and current first.
    rows: tuple[int, ...]
    #: Whether it has not been carried from one window to the next.
    is_new: bool = False

    @property
    def frames(self) -> tuple[int, ...]:
        """Absolute indices of these views."""
        return self.fit.tracks.frames

    @property
    def cam2_from_cam1(self) -> Pose:
        """The adjusted motion of the pair, with |t| = 1."""
        R, t = self.fit.state.R[1], self.fit.state.t[1]
        return Pose(R, t / max(float(np.linalg.norm(t)), 1e-300))

    @cached_property
    def motion(self) -> Motion:
        """The adjusted motion, as the start of the next fit."""
        state = self.fit.state
        # The next fit multiplies the first rotation with its own inverse: rounding errors would double in each frame.
        R = 0.5 * state.R @ (3 * np.eye(3) - np.swapaxes(state.R, 1, 2) @ state.R)
        poses = {frame: Pose(R[k], state.t[k]) for k, frame in enumerate(self.frames)}
        points = WarmStart.of(self.fit.tracks, state, self.fit.explains)
        return Motion(poses, state.plane, state.lens, points, self.is_new)

    def same_as(self, other: FittedMotion) -> bool:
        """Whether two fits ended in the same optimum."""
        rotation_deg, direction_deg = self.difference_deg(other)
        return rotation_deg <= SAME_ROTATION_DEG and direction_deg <= SAME_DIRECTION_DEG

    def difference_deg(self, other: FittedMotion) -> tuple[float, float]:
        """Angles between the rotations and between the directions of the pair."""
        return difference_deg(self.cam2_from_cam1, other.cam2_from_cam1)

    def differences_deg(self, world_from_cam: Mapping[int, Pose]) -> dict[int, tuple[float, float]]:
        """Angles of rotation and direction to the poses of a map, for each of its frames but the reference."""
        reference, motion = world_from_cam[self.frames[0]], self.motion.cam_from_world
        return {
            frame: difference_deg(motion[frame], world_from_cam[frame].inverse() @ reference)
            for frame in self.frames[1:]
            if frame in world_from_cam
        }


@dataclass(frozen=True, eq=False)
class OtherMotion:
    """A rigid motion of tracks that the best motion does not explain: of a moving object, or of the static scene."""

    #: That it is the camera's, and the best motion that of a moving object; 0 where its tracks are few or show none.
    probability: float = 0.0
    #: (M,) The tracks that have this motion; empty where there is none.
    track_ids: Ints = field(default_factory=lambda: np.zeros(0, int))
    #: In all views that these tracks locate; None without one.
    fitted: FittedMotion | None = None
    #: (K,) Tracks of the best motion, which do not have this one.
    of_best: Ints = field(default_factory=lambda: np.zeros(0, int))


def difference_deg(a: Pose, b: Pose) -> tuple[float, float]:
    """Angles between two rotations, and between the directions of two baselines."""
    centre_a, centre_b = a.R.T @ a.t, b.R.T @ b.t
    lengths = max(float(np.linalg.norm(centre_a) * np.linalg.norm(centre_b)), 1e-300)
    direction = math.acos(min(max(float(centre_a @ centre_b) / lengths, -1.0), 1.0))
    return math.degrees(float(rotation_angle(a.R.T @ b.R))), math.degrees(direction)


def farthest_deg(one: Motion, other: Motion) -> tuple[float, float]:
    """Largest angles between the rotations and the directions of two motions, over the views that both know."""
    known = [frame for frame in one.cam_from_world if frame in other.cam_from_world][1:]
    apart = [difference_deg(one.cam_from_world[frame], other.cam_from_world[frame]) for frame in known]
    return max((rotation for rotation, _ in apart), default=0.0), max((aside for _, aside in apart), default=0.0)


def fit_motion(tracks: WindowTracks, motion: Motion, priors: Priors, limits: Limits = LIMITS) -> FittedMotion:
    """Fit a motion to the views that it knows; see :func:`.joint_fit.fit_window`."""
    rows = tuple(motion.known_in(tracks))
    part, start = _started(tracks, motion, motion.plane)
    part = with_translation(part, start)
    known = None if motion.points is None else motion.points.start(part, start)
    return FittedMotion(fit_window(part, start, priors, known=known, limits=limits), rows, motion.is_new)


def noise_factor_at(tracks: WindowTracks, motion: Motion, priors: Priors) -> float:
    """The noise of a motion as a start over the noise of the tracks; see :func:`.joint_fit.start_noise_factor`."""
    return start_noise_factor(*_started(tracks, motion, None), priors)


def _started(tracks: WindowTracks, motion: Motion, plane: Floats | None) -> tuple[WindowTracks, WindowState]:
    """The tracks in the views that a motion knows, and the state at its poses."""
    known = motion.known_in(tracks)
    part, poses = tracks.of_views(tuple(known)), known.values()
    R, t = np.array([pose.R for pose in poses]), np.array([pose.t for pose in poses])
    return part, start_at(part, R, t, plane, lens=motion.lens)


# -- warm start --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class WarmStart:
    """The points of the tracks of a fit."""

    #: (T,) In ascending order.
    track_ids: Ints
    #: (T, 4) Homogeneous, in the world of the motion.
    points: Floats
    #: (T,) Tracks whose point lies on the plane of the fit, and those that the fit explains.
    on_plane: Bools
    explained: Bools

    @staticmethod
    def of(tracks: WindowTracks, state: WindowState, explained: Bools) -> WarmStart:
        """The points of a state.

        Shapes: ``explained`` (T,).
        """
        used = tracks.anchor >= 0
        anchor, rays = tracks.anchor[used], state.rays[used]
        R, t, rho = state.R[anchor], state.t[anchor], state.distances_by_plane(tracks.anchor)[used]
        on_plane = state.on_plane[used] & (state.plane is not None)
        points = np.einsum("tji,tj->ti", R, rays - rho[:, None] * t)
        return WarmStart(tracks.track_ids[used], np.column_stack([points, rho]), on_plane, explained[used])

    def moved(self, new_from_old: Pose) -> WarmStart:
        """The same points in another world."""
        X, w = self.points[:, :3], self.points[:, 3]
        moved = X @ new_from_old.R.T + w[:, None] * new_from_old.t
        return replace(self, points=np.column_stack([moved, w]))

    def start(self, tracks: WindowTracks, state: WindowState) -> WindowState:
        """A state with the rays and the distances of the points that are known; the others as they are."""
        if not len(self.track_ids):
            return state
        at = np.minimum(np.searchsorted(self.track_ids, tracks.track_ids), len(self.track_ids) - 1)
        anchor = np.maximum(tracks.anchor, 0)
        X, w = self.points[at, :3], self.points[at, 3]
        v = np.einsum("tij,tj->ti", state.R[anchor], X) + w[:, None] * state.t[anchor]
        lengths = np.linalg.norm(v, axis=1)
        known = (self.track_ids[at] == tracks.track_ids) & (tracks.anchor >= 0) & (lengths > 0)
        lengths = np.where(known, lengths, 1.0)
        on_plane = self.on_plane[at] & (state.plane is not None)
        points = replace(state, rays=v / lengths[:, None], inverse_distances=w / lengths, on_plane=on_plane)
        return state.with_points_of(points, known)

    def of_tracks(self, track_ids: Ints) -> Floats:
        """The points of some tracks in the world.

        Shapes: ``track_ids`` (N,), returns (N, 3).

        * Returns: NaN for a track that is not known, or that the fit does not explain.
        """
        found = np.full((len(track_ids), 3), np.nan)
        if not self.explained.any():
            return found
        at = np.minimum(np.searchsorted(self.track_ids, track_ids), len(self.track_ids) - 1)
        known = (self.track_ids[at] == track_ids) & self.explained[at]
        X, w = self.points[at[known], :3], self.points[at[known], 3]
        near = np.linalg.norm(self.points[self.explained, :3], axis=1)
        distances = near / np.maximum(self.points[self.explained, 3], 1e-300)
        least = np.linalg.norm(X, axis=1) / (_FAR * float(np.median(distances)))
        found[known] = X / np.maximum(w, np.maximum(least, 1e-300))[:, None]
        return found


# -- what a translation moves while a rolling shutter reads ------------------------------------------------------------


def with_translation(tracks: WindowTracks, state: WindowState) -> WindowTracks:
    """Add what the translation of the camera moves to the sweeps of the tracks, and correct their pixels for it.

    * ``tracks``: In the views of the state. Their sweeps are those of the turning.
    * ``state``: The velocity is that of its poses, the distances are its own.
    * Returns: The same tracks where the time stamps do not increase or no turning is known.
    """
    order = np.argsort(tracks.times_s, kind="stable")
    times = tracks.times_s[order]
    if not tracks.sweep_px_s.any() or (np.diff(times) <= 0).any():
        return tracks
    centres = -np.einsum("kji,kj->ki", state.R, state.t)
    velocity = np.empty_like(centres)
    velocity[order] = np.gradient(centres[order], times, axis=0)
    known = tracks.sweep_px_s.any(axis=2) & tracks.seen & (tracks.anchor >= 0)
    known &= (known.sum(axis=1) >= _LEAST_TRACKS)[:, None]
    flow = _flow_of_translation(tracks, state, np.einsum("kij,kj->ki", state.R, velocity), known)
    added = flow * readout_places(tracks.camera, tracks.pixels)[..., None]
    # The pixels were corrected for the turning alone.
    return replace(tracks, pixels=tracks.pixels - tracks.readout_s * added, sweep_px_s=tracks.sweep_px_s + added)


def _flow_of_translation(tracks: WindowTracks, state: WindowState, velocity: Floats, known: Bools) -> Floats:
    """How the pixels move with the translation of the camera, but for what a rotation explains.

    Shapes: ``velocity`` (V, 3), ``known`` (V, T), returns (V, T, 2).

    * ``velocity``: Of the camera in the axes of the views.
    * ``known``: Observations that turn with the camera.
    * Returns: In pixels per second; 0 for the others, and for points that the lens does not see.
    """
    R, t, anchor = state.R, state.t, np.maximum(tracks.anchor, 0)
    rho = state.distances_by_plane(tracks.anchor)[:, None]
    points = np.einsum("tji,tj->ti", R[anchor], state.rays - rho * t[anchor])
    d = points @ np.swapaxes(R, 1, 2) + rho * t[:, None]
    inverse = 1 / np.sqrt(np.maximum(np.einsum("kti,kti->kt", d, d), 1e-300))[..., None]
    d, by_velocity = d * inverse, -rho * inverse
    used = d * known[..., None]
    # A little more than the information of the rays, which has no inverse where all of them agree.
    information = (known.sum(axis=1) + 1e-9)[:, None, None] * np.eye(3) - np.swapaxes(used, 1, 2) @ used
    pull = np.cross(np.einsum("kto,kti->ki", by_velocity, used), velocity)
    turn = np.linalg.solve(information, pull[..., None])[..., 0]
    moves = by_velocity * velocity[:, None] + d @ np.cross(np.eye(3), turn[:, None])
    flow = tracks.camera.moved_pixels(d.reshape(-1, 3), moves.reshape(-1, 3)).reshape(*known.shape, 2)
    return flow * known[..., None]
