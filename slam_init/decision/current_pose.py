"""The pose of the newest camera before the map and while it grows.

Where a window was evaluated, its best motion, or the camera that only rotates, gives the rotation of its newest frame.
From there the rotation is carried on: the tracks that a frame shares with an anchor are aligned by a rotation. Frames
that were not evaluated mostly have little parallax to all candidates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quest.robust.rotation import refine_rotation
from slam_init.frontend.keyframes import SAME_SCENE
from slam_init.types.arrays import Floats
from slam_init.types.frame import Observations
from slam_init.types.history import History, common_tracks
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose
from slam_init.types.status import CameraPose, PoseKind

#: A rotation needs two rays; with eight, half of them may be outliers.
#: Class: geometry.
_LEAST_TRACKS = 8
#: Scales of the robust kernel, from a fast turn between photographs to the residuals of a parallax of a tenth of a
#: degree.
#: Class: geometry.
_SCALES_RAD = (0.1, 0.03, 0.01, 0.003)
#: Median length of a vector with two Gaussian components of deviation 1.
#: Class: definition.
_MEDIAN_OF_RAYLEIGH = 1.1774
#: A rotation takes up the parallax that all tracks share, and leaves what differs between near and far ones. The
#: inverse depths of a scene vary by a sixth of their mean at least, but for a wall. The number was chosen on Tsukuba,
#: EuRoC, a checkerboard, the hospital, a turning hand and level flight; ``docs/measurements/accuracy.md`` has the share
#: of errors beyond two deviations.
#: Class: assumption.
_SHARED_PARALLAX = 6.0


@dataclass(frozen=True, eq=False)
class WindowMotion:
    """What an evaluated window says of its cameras: those of the best motion, or of the camera that only rotates."""

    #: By absolute frame index.
    cam_from_world: dict[int, Pose]
    #: Reference, and the frame that was evaluated.
    frames: tuple[int, int]
    only_rotates: bool
    rotation_sigma_deg: float
    direction_sigma_deg: float


class CurrentPose:
    """Keeps the rotation of each frame of the history from the first frame, and gives the pose of the newest."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Floats, float]] = {}
        self._anchor: int | None = None

    def update(
        self, history: History, current: Observations, window: WindowMotion | None, map_: InitialMap | None
    ) -> CameraPose | None:
        """Go on with a frame, what its evaluation says, and the map if it was accepted; return the pose of the frame.

        * Returns: None for the first frame, and where too few tracks link a frame without a map to it.
        """
        if self._anchor is None:
            self._known, self._anchor = {current.frame: (np.eye(3), 0.0)}, current.frame
            return None
        if window is not None:
            self._fix(history, window)
        found = self._known.get(current.frame) or self._from_anchor(history, current)
        self._known = {frame: one for frame, one in self._known.items() if frame in history}
        if found is not None:
            self._known[current.frame] = found
        if map_ is not None:
            newest = max(map_.keyframes, key=lambda one: one.frame if one.frame <= current.frame else -1)
            sigmas_deg = (0.0, None) if window is None else (window.rotation_sigma_deg, window.direction_sigma_deg)
            return self.located(map_, newest, *sigmas_deg)
        if found is None:
            return None
        R, variance = found
        if window is None or window.only_rotates or current.frame not in window.cam_from_world:
            return CameraPose(PoseKind.ROTATION, R, math.degrees(math.sqrt(variance)))
        reference = window.frames[0]
        pose = window.cam_from_world[current.frame] @ window.cam_from_world[reference].inverse()
        baseline = window.cam_from_world[window.frames[1]] @ window.cam_from_world[reference].inverse()
        centre = -R.T @ pose.t / max(float(np.linalg.norm(baseline.t)), 1e-300)
        return CameraPose(
            PoseKind.PROVISIONAL, R, math.degrees(math.sqrt(variance)), centre, window.direction_sigma_deg, reference
        )

    def _fix(self, history: History, window: WindowMotion) -> None:
        """Take the rotation of the evaluated frame from that of the reference, where this is known."""
        reference, evaluated = window.frames
        start = self._known.get(reference)
        if start is None or evaluated not in history or evaluated not in window.cam_from_world:
            return
        turned = window.cam_from_world[evaluated].R @ window.cam_from_world[reference].R.T
        sigma_rad = math.radians(window.rotation_sigma_deg)
        if window.only_rotates and reference in history:
            i, j = common_tracks(history[reference], history[evaluated])
            sigma_rad = _sigma_rad(turned, history[reference].bearings[i], history[evaluated].bearings[j])
        self._known[evaluated] = (turned @ start[0], start[1] + sigma_rad**2)
        self._anchor = evaluated

    def _from_anchor(self, history: History, current: Observations) -> tuple[Floats, float] | None:
        """The rotation of a frame by the tracks that it shares with the anchor, or with the frame before."""
        before = max((frame for frame in self._known if frame in history), default=None)
        for anchor in (self._anchor, before):
            if anchor is None or anchor not in history or anchor not in self._known:
                continue
            i, j = common_tracks(history[anchor], current)
            if len(i) >= _LEAST_TRACKS and (len(i) >= SAME_SCENE * len(current) or anchor == before):
                self._anchor = anchor
                m, n = history[anchor].bearings[i], current.bearings[j]
                R = refine_rotation(np.eye(3), m, n, *_SCALES_RAD, iterations=4)
                known, variance = self._known[anchor]
                return R @ known, variance + _sigma_rad(R, m, n) ** 2
        return None

    def located(
        self, map_: InitialMap, view: Keyframe, rotation_sigma_deg: float, direction_sigma_deg: float | None = None
    ) -> CameraPose:
        """The pose of a view of the accepted map; in the axes of its reference where nothing links it to the start."""
        first = next((one for one in map_.keyframes if one.frame in self._known), map_.keyframes[0])
        start, variance = self._known.get(first.frame, (np.eye(3), 0.0))
        cam_from_first = view.world_from_cam.R.T @ first.world_from_cam.R @ start
        centre = view.world_from_cam.t - map_.keyframes[0].world_from_cam.t
        return CameraPose(
            PoseKind.MAP,
            cam_from_first,
            math.hypot(math.degrees(math.sqrt(variance)), rotation_sigma_deg),
            start.T @ first.world_from_cam.R.T @ centre,
            direction_sigma_deg,
            map_.keyframes[0].frame,
        )


def _sigma_rad(R: Floats, m: Floats, n: Floats) -> float:
    """Standard deviation of a rotation ``n = R m`` by what it leaves of the tracks, which may be parallax."""
    left = np.linalg.norm(np.cross(n, m @ R.T), axis=1)
    return _SHARED_PARALLAX * float(np.median(left)) / _MEDIAN_OF_RAYLEIGH
