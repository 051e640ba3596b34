"""The map after its acceptance: it locates the next frames, and grows by keyframes and landmarks.

A frame is located by resection with the landmarks that its tracks belong to. Where its parallax to the last keyframe
reaches a degree, or where it sees too few of the landmarks of that one again, it becomes a keyframe: tracks without a
landmark are triangulated, and poses and points of the last keyframes are adjusted together, in least squares without
outliers. The first pose of the window and its longest baseline are held, so that the map keeps its frame and its unit.
This is no SLAM: no loop is closed, and a track that is lost comes back only where descriptors find it within some
frames.

The map is lost where fewer than ``min_resected`` tracks of landmarks are left, or where no pose agrees with that many
landmarks in five frames in a row. The first of these frames is the one from which a new map may begin.

gtsam's smoothers do the same work from the graph of the map. Of a map of 780 landmarks, its fixed-lag smoother took
630 ms a keyframe, since it orders all landmarks of the newest keyframe last. A frame of this map, with its tracks and
its adjustment, took 14 to 27 ms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from slam_init.bundle.adjustment import solution_of
from slam_init.bundle.least_squares import minimize, with_lenses
from slam_init.bundle.problem import BundleFailure, BundleProblem
from slam_init.bundle.shared_errors import LocatedRotation
from slam_init.config import MapConfig
from slam_init.frontend.rolling_shutter import RollingShutter, corrected_pixels
from slam_init.mapping.map_building import initial_map
from slam_init.mapping.resection import parallax_rad, resect, triangulate
from slam_init.mapping.views import seen_by
from slam_init.system.linear_algebra import deviations
from slam_init.types.arrays import Bools, Floats, Image, Ints
from slam_init.types.frame import Observations
from slam_init.types.history import History
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose

#: A landmark counts as observed again where its track lies within this distance of its projection.
_SURVIVAL_PX = 3.0
#: A blur or a flash of a sixth of a second loses no map whose tracks go on after it.
_LOST_AFTER = 5
#: Parallax of a new keyframe, and least parallax of a new landmark: at a noise of .5 px and a focal length of 500 px, a
#: depth is known to sqrt(2) 0.5 / 500 / 0.0175 = 8 % then, a fifth of what the map leaves out.
_PARALLAX_DEG = 1.0
#: A frame becomes a keyframe as well where it sees less than this share of the landmarks of the last one. Near points
#: leave the view first, and the parallax of the far ones that are left may never reach a degree. ORB-SLAM asks for nine
#: tenths. From starts 0, 7 and 14 of 28 photographs of a street, 34 are located with three quarters, 30 with a half,
#: and 16 without; paths on five videos change by less than a tenth of a percent of their length.
#: Class: measured.
_SEEN_AGAIN = 0.75
#: A new landmark is seen in so many keyframes: two give a depth, and one more tests it. Photographs follow each other
#: at this parallax and more, and their tracks end after two or three. There two are enough: three pixels from an
#: epipolar line are a hundredth of the image, so that most wrong matches are found by it.
_LEAST_VIEWS, _WIDE_DEG = 3, 5.0
#: Keyframes that are adjusted together: a bound of memory and time. At a degree of parallax each they span 24 degrees.
_WINDOW = 24
#: Levenberg-Marquardt steps of a keyframe: its pose and points are known to some pixels already. Steps and tolerance of
#: a map that is final, whose last outliers have left it: gtsam lowers its error by a thousandth then.
_ITERATIONS, _LAST_ITERATIONS, _LAST_TOLERANCE = 4, 20, 1e-6


@dataclass(frozen=True, eq=False)
class Located:
    """A frame that was located."""

    keyframe: Keyframe
    #: Share of the landmarks of the accepted map that the frame observes within 3 px of their projection.
    survival: float
    #: The map with the frame as its newest view, and the errors of its observations.
    problem: BundleProblem
    errors: LocatedRotation
    #: Standard deviation of the rotation of the first keyframe, which the map holds: larger than 0 where older ones
    #: have left the window; pi where too few landmarks agree with the pose.
    first_sigma_rad: float

    @cached_property
    def rotation_sigma_rad(self) -> float:
        """Standard deviation of the rotation from the first frame of the map, with the errors that landmarks share.

        It takes half as long as to locate the frame, so it is computed when it is asked for.
        """
        return min(math.hypot(self.first_sigma_rad, self.errors.sigma_rad(self.problem)), math.pi)


class GrowingMap:
    """A map that goes on with the tracks of its initializer.

    * ``camera``: That of the map.
    * ``lost_at``: Absolute index of the first frame in which the map was lost; None while it is not.
    * ``keyframes_added``: Number of keyframes since the acceptance.
    """

    def __init__(self, map_: InitialMap, config: MapConfig | None = None) -> None:
        self.camera = map_.camera
        self.lost_at: int | None = None
        self.keyframes_added = 0
        self._accepted, self._config = map_, config or MapConfig()
        self._shutter, self._rays = RollingShutter(map_.camera), History(map_.camera, 2)
        self._problem = with_lenses(
            map_.camera,
            BundleProblem(
                frames=tuple(keyframe.frame for keyframe in map_.keyframes),
                world_from_cam=tuple(keyframe.world_from_cam for keyframe in map_.keyframes),
                points=map_.points,
                track_ids=map_.track_ids,
                views=map_.observation_keyframes,
                landmarks=map_.observation_landmarks,
                pixels=map_.observation_pixels,
            ),
        )
        # The tracks of keyframes that may become landmarks.
        tracks = map_.open_tracks
        if tracks.turn_rad_s is not None:
            tracks = self._shutter.corrected(map_.camera, tracks, tracks.turn_rad_s)
        self._views = {tracks.frame: tracks}
        self._noise_px = map_.noise_px
        # The deviation of the rotation of each keyframe when it was the newest one.
        self._sigmas_rad = _rotation_sigmas_rad(map_)
        self._errors: LocatedRotation | None = None
        self._guess: Pose | None = None
        self._misses: list[int] = []

    def locate(self, observed: Observations, revised: Sequence[Observations] = ()) -> Located | None:
        """Locate the next frame, and make a keyframe of it where its parallax is large enough.

        * ``revised``: Earlier frames with more tracks than before: descriptors have found points of theirs in this one.
        """
        # A rolling shutter moves the rays of video, which descriptors hardly ever link.
        for one in () if self.camera.readout_s else revised:
            if one.frame in self._problem.frames:
                self._views[one.frame] = one.through(self.camera)
        # With the rays of the camera of the map, at the middle of the readout.
        self._rays.put(observed.through(self.camera))
        self._rays.forget(keep=())
        seen = self._shutter.correct_newest(self._rays, observed.frame)
        _, i, j = np.intersect1d(self._problem.track_ids, seen.track_ids, return_indices=True)
        gate_rad = _SURVIVAL_PX / self.camera.focal_px
        resected = resect(self._problem.points[i], seen.bearings[j], gate_rad, self._guess)
        self._evaluate(seen.frame, len(i), 0 if resected is None else int(resected[1].sum()))
        if resected is None:
            return None
        self._guess, agreeing = resected
        i, j = i[agreeing], j[agreeing]
        pixels = corrected_pixels(self.camera, seen)
        longer = self._problem.with_view(seen.frame, self._guess.inverse(), i, pixels[j])
        if len(i) >= self._config.min_resected and self._is_due(i, self._guess):
            self._guess = self._extend(seen, longer) or self._guess
        keyframe = Keyframe(seen.frame, seen.timestamp_s, seen.name, self._guess.inverse())
        # Twice the views know the errors better; to state them takes as long as a frame.
        if self._errors is None or len(self._problem.frames) >= 2 * self._errors.keyframes:
            self._errors = LocatedRotation.of(self.camera, self._problem, self._config)
        is_keyframe = self._problem.frames[-1] == seen.frame
        problem = self._problem if is_keyframe else longer
        # Fewer landmarks than a pose needs may agree with a wrong one by chance.
        first_sigma_rad = math.pi if self._misses else self._sigmas_rad.get(problem.frames[0], 0.0)
        survival = self._survival(seen.track_ids, pixels, self._guess)
        located = Located(keyframe, survival, problem, self._errors, first_sigma_rad)
        if is_keyframe:
            kept = {frame: sigma for frame, sigma in self._sigmas_rad.items() if frame in problem.frames}
            self._sigmas_rad = {**kept, seen.frame: located.rotation_sigma_rad}
        return located

    def grown(self) -> InitialMap:
        """The map as it is now; the accepted map where no keyframe was added."""
        accepted, problem = self._accepted, self._problem
        if problem.frames == tuple(keyframe.frame for keyframe in accepted.keyframes):
            return accepted
        try:
            problem, _ = minimize(problem, self._noise_px, iterations=_LAST_ITERATIONS, tolerance=_LAST_TOLERANCE)
        except RuntimeError:  # a landmark behind a camera
            return accepted
        bundle = solution_of(self.camera, problem, self._config)
        if isinstance(bundle, BundleFailure):
            return accepted
        views = [self._view(frame) for frame in problem.frames]
        made = initial_map(bundle, views, accepted.scene)
        return replace(
            made,
            colors=_colors(made, accepted),
            focal_factor=accepted.focal_factor,
            focal_factor_sigma=accepted.focal_factor_sigma,
            model_risk=accepted.model_risk,
            gravity=accepted.gravity,
        )

    # -- parts of the step of a frame -------------------------------------------------------------

    def _evaluate(self, frame: int, tracked: int, agreeing: int) -> None:
        """Find out whether the map is lost."""
        least = self._config.min_resected
        self._misses = [] if agreeing >= least else [*self._misses, frame]
        if tracked < least or len(self._misses) >= _LOST_AFTER:
            self.lost_at = min([frame, *self._misses]) if self.lost_at is None else self.lost_at

    def _is_due(self, landmarks: Ints, pose: Pose) -> bool:
        """Whether a frame that sees some landmarks becomes a keyframe."""
        in_last = np.count_nonzero(self._problem.views == len(self._problem.frames) - 1)
        centres = pose.inverse().t, self._problem.world_from_cam[-1].t
        parallax_deg = np.degrees(np.median(parallax_rad(self._problem.points[landmarks], *centres)))
        return bool(len(landmarks) < _SEEN_AGAIN * in_last or parallax_deg >= _PARALLAX_DEG)

    def _survival(self, track_ids: Ints, pixels: Floats, pose: Pose) -> float:
        """The share of the landmarks of the accepted map that a frame observes near their projection."""
        accepted = np.isin(self._problem.track_ids, self._accepted.track_ids)
        _, i, j = np.intersect1d(self._problem.track_ids[accepted], track_ids, return_indices=True)
        projected = self.camera.project(pose.apply(self._problem.points[accepted][i]))
        error_px = np.linalg.norm(projected - pixels[j], axis=1)
        return float(np.sum(error_px < _SURVIVAL_PX)) / len(self._accepted.points)

    def _extend(self, seen: Observations, longer: BundleProblem) -> Pose | None:
        """Make a keyframe of a located frame, with new landmarks, and adjust the window.

        * ``longer``: The map with the frame as its newest view.
        * Returns: The pose of the frame; None where it becomes no keyframe.
        """
        views = {frame: view for frame, view in self._views.items() if frame in self._problem.frames}
        self._views = {**views, seen.frame: seen}
        known = len(longer.points)
        tracks, points = self._new_landmarks(seen, dict(zip(longer.frames, longer.world_from_cam, strict=True)))
        longer = replace(
            longer,
            points=np.concatenate([longer.points, points]),
            track_ids=np.concatenate([longer.track_ids, tracks]),
        )
        for frame, view in self._views.items():
            _, of_track, of_view = np.intersect1d(tracks, view.track_ids, return_indices=True)
            pixels = corrected_pixels(self.camera, view)[of_view]
            longer = longer.with_observations(longer.frames.index(frame), known + of_track, pixels)
        last = _last(with_lenses(self.camera, longer), _WINDOW)
        try:
            adjusted, _ = minimize(last, self._noise_px, iterations=_ITERATIONS, tolerance=1e-4)
        except RuntimeError:  # a landmark behind a camera: the frame is located, and it is no keyframe
            return None
        residuals = adjusted.residuals(self.camera)
        noise_px = adjusted.robust_noise_px(residuals, self._config)
        good: Bools = np.asarray(np.linalg.norm(residuals, axis=1) < self._config.outlier_sigmas * noise_px)
        kept = adjusted.keep(good)
        if np.bincount(kept.views, minlength=len(kept.frames)).min() < 6:
            return None
        self._problem, self._noise_px = kept, noise_px
        self.keyframes_added += 1
        return kept.world_from_cam[-1].inverse()

    def _new_landmarks(self, seen: Observations, poses: dict[int, Pose]) -> tuple[Ints, Floats]:
        """Triangulate the tracks of a frame that have no landmark and whose depths are known.

        * Returns: Their tracks and points.
        """
        tracks = np.setdiff1d(seen.track_ids, self._problem.track_ids)
        frames = list(self._views)  # the newest is the last one
        _, bearings = seen_by(list(self._views.values()), tracks)
        observed = np.isfinite(bearings[:, :, 0])
        points = triangulate([poses[frame] for frame in frames], bearings)
        good: Bools = np.asarray(np.isfinite(points).all(axis=1) & (observed.sum(axis=0) >= 2))
        rays = np.full_like(bearings, np.nan)
        for k, frame in enumerate(frames):
            in_camera = poses[frame].inverse().apply(points)
            in_camera /= np.linalg.norm(in_camera, axis=1, keepdims=True)
            off = np.linalg.norm(in_camera - bearings[k], axis=1)
            good &= ~observed[k] | (off < _SURVIVAL_PX / self.camera.focal_px)
            rays[k] = bearings[k] @ poses[frame].R.T
        cosine = np.where(observed, np.einsum("vti,ti->vt", rays, rays[-1]), 1.0)
        least_deg = np.where(observed.sum(axis=0) < _LEAST_VIEWS, _WIDE_DEG, _PARALLAX_DEG)
        good &= cosine.min(axis=0, initial=1.0) < np.cos(np.radians(least_deg))
        return tracks[good], points[good]

    def _view(self, frame: int) -> Observations:
        """The tracks of a keyframe; none for those of the accepted map, whose tracks are not known."""
        if frame in self._views:
            return self._views[frame]
        keyframe = next(one for one in self._accepted.keyframes if one.frame == frame)
        none = self._accepted.open_tracks.at(np.zeros(0, np.int64))
        return replace(none, frame=frame, timestamp_s=keyframe.timestamp_s, name=keyframe.name)


def _rotation_sigmas_rad(map_: InitialMap) -> dict[int, float]:
    """Standard deviations of the rotations of the keyframes, by their frames; none without covariances."""
    if not len(map_.pose_covariances):
        return {}
    sigmas = deviations(np.linalg.eigvalsh(map_.pose_covariances[:, :3, :3]))[:, -1]
    return {keyframe.frame: float(sigma) for keyframe, sigma in zip(map_.keyframes, sigmas, strict=True)}


def _colors(made: InitialMap, accepted: InitialMap) -> Image:
    """The colors of a map, those of the accepted map where it has the landmark."""
    _, at, of = np.intersect1d(made.track_ids, accepted.track_ids, return_indices=True)
    colors = made.colors.copy()
    colors[at] = accepted.colors[of]
    return colors


def _last(problem: BundleProblem, count: int) -> BundleProblem:
    """The last keyframes of a problem, with the landmarks that two of them see."""
    dropped = max(len(problem.frames) - count, 0)
    if dropped == 0:
        return problem
    kept = problem.keep(np.asarray(problem.views >= dropped))
    return replace(
        kept,
        frames=kept.frames[dropped:],
        world_from_cam=kept.world_from_cam[dropped:],
        views=kept.views - dropped,
    )
