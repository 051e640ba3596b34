"""What else the poses of a file may mean: the conventions that programs mix up.

Files of poses seldom state their convention. Read in another one than its own, a right trajectory is another motion.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from quest.geometry.epipolar import depths_from_pose
from quest.geometry.quaternion import rotation_angle
from slam_init.auditing.audit import audit
from slam_init.config import Config
from slam_init.datasets.posed_images import AXES, with_axes
from slam_init.decision.evaluated_window import off_plane
from slam_init.errors import SlamInitError
from slam_init.types.arrays import evenly_spaced
from slam_init.types.audit import Audit
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.history import common_tracks
from slam_init.types.pose import Pose

#: The order in a file whose quaternions were read in the other order, and the places that their parts move by.
#: Class: geometry.
_ORDERS = {"": 0, "quaternions with w first": -1, "quaternions with w last": 1}
#: Readings are compared on pairs of so many frames, each with the next ones: 30 pairs take half a second.
#: Class: budget.
_MOST_FRAMES, _NEXT_FRAMES = 12, 3
#: A match that is farther from its epipolar line, or behind a camera, counts as an outlier.
#: Class: level.
_OUTLIER_PX = 4.0
#: The rotations distinguish two readings by so many standard deviations. Where the camera hardly turns, a wrong
#: direction is right in one of the many readings by chance.
#: Class: level.
_SIGNIFICANT_SIGMAS = 3.0


@dataclass(frozen=True)
class Reading:
    """A convention of poses."""

    #: A key of :data:`_ORDERS`.
    order: str
    inverse: bool
    #: A key of :data:`AXES`; empty for those of this project.
    axes: str

    def __str__(self) -> str:
        stated = (self.order, "cam_from_world" if self.inverse else "", self.axes and f"camera axes {self.axes}")
        return ", ".join(one for one in stated if one)

    def of(self, poses: Mapping[int, Pose]) -> dict[int, Pose]:
        """World_from_cam in this convention, for poses that were read as world_from_cam."""
        return {frame: self._of(pose) for frame, pose in poses.items()}

    def _of(self, pose: Pose) -> Pose:
        if self.order:
            pose = Pose.from_quaternion(np.roll(pose.q_wxyz, _ORDERS[self.order]), pose.t)
        if self.inverse:
            pose = pose.inverse()
        return with_axes(pose, self.axes) if self.axes else pose


@dataclass(frozen=True)
class FittingReading:
    """A reading in which poses are a sound map."""

    reading: Reading
    audit: Audit


#: That of this project stands first. Further combinations would fit more wrong maps by chance.
#: Class: level.
READINGS = (
    *itertools.starmap(Reading, itertools.product(_ORDERS, (False, True), ("",))),
    *(Reading("", False, axes) for axes in AXES),
)


def fitting_reading(
    poses: Mapping[int, Pose], tracks: Sequence[Observations], camera: Camera, config: Config
) -> FittingReading | None:
    """The other reading in which the poses are a sound map, with its audit.

    * ``poses``: World_from_cam, as they were read.
    * Returns: None where the given reading fits best, or the rotations do not confirm the other one.
    """
    views = {view.frame: view for view in tracks if view.frame in poses}
    misfits = [_misfit_px(reading.of(poses), views, camera) for reading in READINGS]
    reading = READINGS[int(np.argmin(misfits))]
    if reading is READINGS[0]:
        return None
    others = reading.of(poses)
    try:
        found = audit(others, tracks, camera, config)
    except SlamInitError:  # poses that cannot be evaluated do not fit
        return None
    first, *frames = (frame for frame in found.frames if frame in poses)
    turned = [(one[first].inverse() @ one[frame]).R for frame in frames for one in (poses, others)]
    angles = [rotation_angle(a @ b.T) for a, b in zip(turned[::2], turned[1::2], strict=True)]
    significant = np.degrees(max(angles)) > _SIGNIFICANT_SIGMAS * found.rotation_sigma_deg
    return FittingReading(reading, found) if found and significant else None


def _misfit_px(poses: Mapping[int, Pose], views: Mapping[int, Observations], camera: Camera) -> float:
    """Mean distance of the matches from their epipolar lines, which outliers bound."""
    frames = [sorted(views)[k] for k in evenly_spaced(len(views), _MOST_FRAMES).tolist()]
    misfits = [0.0]
    for k, first in enumerate(frames):
        for second in frames[k + 1 : k + 1 + _NEXT_FRAMES]:
            pose = poses[second].inverse() @ poses[first]
            i, j = common_tracks(views[first], views[second])
            if len(i) and pose.t.any():
                rays1, rays2 = views[first].bearings[i], views[second].bearings[j]
                depths, others = depths_from_pose(pose.R, pose.t, rays1, rays2)
                off_px = camera.focal_px * off_plane(pose, rays1, rays2)
                misfits.append(
                    float(np.where((depths > 0) & (others > 0), off_px, np.inf).clip(max=_OUTLIER_PX).mean())
                )
    return float(np.mean(misfits))
