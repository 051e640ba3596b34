"""A motion of the camera through the views of a window, and its joint fit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from quest.geometry.quaternion import rotation_angle
from slam_init.types.arrays import Floats, Ints
from slam_init.types.lens import SAME_LENS, Lens
from slam_init.types.pose import Pose
from slam_init.window.joint_fit import MAX_STEPS, JointFit, fit_window, start_noise_factor
from slam_init.window.levels import (
    NEAR_DIRECTION_DEG,
    NEAR_ROTATION_DEG,
    SAME_DIRECTION_DEG,
    SAME_ROTATION_DEG,
)
from slam_init.window.row_motion import with_translation
from slam_init.window.state import Priors, WindowState, start_at
from slam_init.window.tracks import WindowTracks
from slam_init.window.warm_start import WarmStart


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
    #: Absolute indices of these views.
    frames: tuple[int, ...]
    #: Whether it has not been carried from one window to the next.
    is_new: bool = False

    @property
    def tracks(self) -> WindowTracks:
        """The tracks in the views of the fit, as they were fitted."""
        return self.fit.tracks

    @property
    def cam2_from_cam1(self) -> Pose:
        """The adjusted motion of the pair, with |t| = 1."""
        R, t = self.fit.state.R[1], self.fit.state.t[1]
        return Pose(R, t / max(float(np.linalg.norm(t)), 1e-300))

    @property
    def planar(self) -> bool:
        """Whether most points were held on a plane."""
        return self.fit.state.plane is not None

    @cached_property
    def motion(self) -> Motion:
        """The adjusted motion, as the start of the next fit."""
        state = self.fit.state
        # The next fit multiplies the first rotation with its own inverse: rounding errors would double in each frame.
        R = 0.5 * state.R @ (3 * np.eye(3) - np.swapaxes(state.R, 1, 2) @ state.R)
        poses = {frame: Pose(R[k], state.t[k]) for k, frame in enumerate(self.frames)}
        points = WarmStart.of(self.tracks, state, self.fit.explains)
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
    track_ids: Ints = dataclasses.field(default_factory=lambda: np.zeros(0, int))
    #: In all views that these tracks locate; None without one.
    fitted: FittedMotion | None = None
    #: (K,) Tracks of the best motion, which do not have this one.
    of_best: Ints = dataclasses.field(default_factory=lambda: np.zeros(0, int))


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


def fit_motion(
    tracks: WindowTracks,
    motion: Motion,
    priors: Priors,
    hopeless: float = math.inf,
    *,
    max_steps: int = MAX_STEPS,
    give_up: float = math.inf,
) -> FittedMotion:
    """Fit a motion to the views that it knows; see :func:`.joint_fit.fit_window`."""
    part, R, t, rows = _part_of(tracks, motion)
    frames = tuple(tracks.frames[row] for row in rows)
    start = _start(part, R, t, motion, motion.plane)
    part = with_translation(part, start)
    known = None if motion.points is None else motion.points.start(part, start)
    fit = fit_window(part, start, priors, known=known, hopeless=hopeless, give_up=give_up, max_steps=max_steps)
    return FittedMotion(fit, rows, frames, motion.is_new)


def noise_factor_at(tracks: WindowTracks, motion: Motion, priors: Priors) -> float:
    """The noise of a motion as a start over the noise of the tracks; see :func:`.joint_fit.start_noise_factor`."""
    part, R, t, _ = _part_of(tracks, motion)
    return start_noise_factor(part, _start(part, R, t, motion), priors)


def _start(part: WindowTracks, R: Floats, t: Floats, motion: Motion, plane: Floats | None = None) -> WindowState:
    return start_at(part, R, t, plane, lens=motion.lens)


def _part_of(tracks: WindowTracks, motion: Motion) -> tuple[WindowTracks, Floats, Floats, tuple[int, ...]]:
    """The tracks in the views of a located motion, its rotations and translations, and the rows of the views."""
    rows = tuple(row for row, frame in enumerate(tracks.frames) if frame in motion.cam_from_world)
    poses = [motion.cam_from_world[tracks.frames[row]] for row in rows]
    return tracks.of_views(rows), np.array([pose.R for pose in poses]), np.array([pose.t for pose in poses]), rows
