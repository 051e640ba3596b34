"""Finds the frames of another video in a saved map, and lets the place of the map grow with them.

The SIFT keypoints of a frame are matched with the points of the place, and the camera is resected from the matches. The
number of poses that explain as many matches by chance is bounded as in :mod:`slam_init.mapping.joining`: three matches
have up to four poses. Where the camera has moved on by a degree of parallax, the frame becomes a view, and what the
last views see beside the known points is triangulated. So the map goes on where the video leaves it, and is found again
after a gap. Poses and points are not adjusted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from math import log

import numpy as np

from quest.chance import false_alarms, log_binomial, upper_share
from quest.display import Described
from slam_init.errors import SlamInitError
from slam_init.frontend.sift import detect_sift, match_descriptors
from slam_init.mapping.joining import MAX_RISK
from slam_init.mapping.places import GATE_PX, KEYPOINTS, RATIO, place_of_features
from slam_init.mapping.resection import resect
from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, as_image
from slam_init.types.initial_map import Keyframe
from slam_init.types.place import Place
from slam_init.types.pose import Pose

#: Gates of the test of chance, as shares; the wide gate by which random matches are counted; and shifts of the matches
#: that stand for random ones. Class: definition.
_GATES, _WIDE, _SHUFFLES = 0.5 ** np.arange(4.0), 16.0, 20
#: Poses of a sample of three points. Class: geometry.
_POSES = 4
#: Parallax of a new view, as of a keyframe of a map that grows; and the last new views that are triangulated together.
#: Class: assumption.
_PARALLAX_DEG, _LAST = 1.0, 4


@dataclass(frozen=True, eq=False, repr=False)
class Found(Described):
    """Whether a frame was found in a map. Truthy when it was.

    Attributes
    ----------
    keyframe : Keyframe or None
        The frame with its pose in the frame and the unit of the map. None where it was not found.
    risk : float
        Expected number of poses that explain as many matches by chance, at most 1.
    matches : int
        Number of points of the map with a similar descriptor in the frame.
    inliers : int
        Number of these that the pose explains.
    """

    keyframe: Keyframe | None
    risk: float
    matches: int
    inliers: int

    def __bool__(self) -> bool:
        return self.keyframe is not None

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        title = "not found" if self.keyframe is None else f"frame {self.keyframe.frame} found"
        return title, [("matches", f"{self.inliers} of {self.matches} agree, risk {self.risk:.2g} that by chance")]


class Finder:
    """Finds frames in a saved map, one after the other.

    Parameters
    ----------
    place : Place
        From :func:`slam_init.load_place`.
    camera : Camera
        The calibration of the frames, which may be another camera than that of the map.
    grow : bool
        Whether frames that are found become views with points of their own.

    Attributes
    ----------
    place : Place
        As it has grown.
    """

    def __init__(self, place: Place, camera: Camera, grow: bool = True) -> None:
        if not isinstance(place, Place) or not isinstance(camera, Camera):
            kinds = f"{type(place).__name__}, {type(camera).__name__}"
            raise SlamInitError(f"a Finder of {kinds}: give load_place(PATH), and a Camera (slam_init.load_camera)")
        self.place = place
        self._camera, self._grow = camera, grow
        self._guess: Pose | None = None
        # The views that were added, with all their features.
        self._added: list[tuple[Keyframe, Floats, Floats]] = []

    def locate(self, frame: Frame) -> Found:
        """Find the next frame.

        Parameters
        ----------
        frame : Frame

        Returns
        -------
        Found
            Falsy where chance explains as many matches.

        Raises
        ------
        SlamInitError
            If this is no frame, or its image has not the size of the calibration.
        """
        camera = self._camera
        if not isinstance(frame, Frame):
            raise SlamInitError(f"a {type(frame).__name__} is no frame: give Frame(index, timestamp_s, name, image)")
        as_image(frame.image, f"the image of frame {frame.index}", (camera.width, camera.height))
        found = detect_sift(frame.gray, KEYPOINTS)
        rays = camera.bearings(found.pixels)
        known = np.isfinite(rays).all(axis=1)
        return self.locate_features(frame.index, frame.timestamp_s, frame.name, rays[known], found.descriptors[known])

    def locate_features(self, index: int, timestamp_s: float, name: str, rays: Floats, described: Floats) -> Found:
        """The same from the rays (N, 3) and the RootSIFT descriptors (N, 128) of its keypoints."""
        gate_rad = GATE_PX / self._camera.focal_px
        i, j = match_descriptors(self.place.descriptors, described, RATIO)
        resected = resect(self.place.points[i], rays[j], gate_rad, self._guess)
        if resected is None:
            return Found(None, 1.0, len(i), 0)
        pose, inliers = resected
        count = int(inliers.sum())
        risk = min(1.0, _chance(self.place.points[i], rays[j], pose, gate_rad))
        if risk > MAX_RISK:
            return Found(None, risk, len(i), count)
        self._guess = pose
        keyframe = Keyframe(index, timestamp_s, name, pose.inverse())
        if self._grow and self._moved_on(keyframe, self.place.points[i[inliers]]):
            self._extend(keyframe, rays, described)
        return Found(keyframe, risk, len(i), count)

    def _moved_on(self, keyframe: Keyframe, points: Floats) -> bool:
        """Whether the parallax to each view that was added is large enough; the first frame is one."""
        for view, _, _ in self._added[-_LAST:]:
            a, b = points - keyframe.world_from_cam.t, points - view.world_from_cam.t
            cosine = np.sum(a * b, axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
            if math.degrees(math.acos(float(np.clip(np.median(cosine), -1, 1)))) < _PARALLAX_DEG:
                return False
        return True

    def _extend(self, keyframe: Keyframe, rays: Floats, described: Floats) -> None:
        """Add a view, and what it and the last ones see that is not known yet."""
        self._added = [*self._added, (keyframe, rays, described)][-_LAST:]
        views, seen, descriptors = zip(*self._added, strict=True)
        new = place_of_features(views, seen, descriptors, self._camera.focal_px)
        known, _ = match_descriptors(new.descriptors, self.place.descriptors, RATIO)
        self.place = _together(self.place, _without(new, np.isin(np.arange(len(new.points)), known)))


def _chance(points: Floats, rays: Floats, pose: Pose, gate_rad: float) -> float:
    """Expected number of poses that explain as many random matches."""
    directions = pose.apply(points)
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    total, shifts = len(points), range(1, min(len(points), _SHUFFLES + 1))
    wide = sum(
        int(np.count_nonzero(np.linalg.norm(directions - np.roll(rays, shift, axis=0), axis=1) < _WIDE * gate_rad))
        for shift in shifts
    )
    # A random point lies in a gate as often as its area says.
    share = np.asarray(upper_share(wide, len(shifts) * total) * (_GATES / _WIDE) ** 2)
    errors = np.linalg.norm(directions - rays, axis=1)
    counts = np.array([np.count_nonzero(errors < gate_rad * gate) for gate in _GATES])
    return false_alarms(counts, total, 3, log(_POSES * len(_GATES)) + log_binomial(total, 3), share)


def _without(place: Place, dropped: Bools) -> Place:
    """A place without some of its points."""
    number, rows = np.cumsum(~dropped) - 1, ~dropped[place.observation_points]
    return replace(
        place,
        points=place.points[~dropped],
        descriptors=place.descriptors[~dropped],
        observation_views=place.observation_views[rows],
        observation_points=number[place.observation_points[rows]],
        observation_bearings=place.observation_bearings[rows],
    )


def _together(first: Place, second: Place) -> Place:
    """Two places of one frame and unit as one."""
    return Place(
        (*first.views, *second.views),
        np.concatenate([first.points, second.points]),
        np.concatenate([first.descriptors, second.descriptors]),
        np.concatenate([first.observation_views, len(first.views) + second.observation_views]),
        np.concatenate([first.observation_points, len(first.points) + second.observation_points]),
        np.concatenate([first.observation_bearings, second.observation_bearings]),
        max(first.noise_rad, second.noise_rad),
        first.unit_error,
        first.lens,
    )
