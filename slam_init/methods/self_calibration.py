"""The calibration of a camera from a whole video: ``slam-init calibrate``.

A video is initialized again and again, each time from where the last initialization ended. Each stretch gives an
estimate of the focal length and of the distortion with standard deviations, that of its most certain window. Stretches
share no frames, so the estimates are independent, and their weighted mean is the calibration.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from slam_init.bundle.lens_fit import fit_lens
from slam_init.bundle.problem import BundleProblem
from slam_init.config import Config
from slam_init.datasets.track_source import TrackProvider
from slam_init.frontend.matched_tracks import make_tracker
from slam_init.initializer import FittedPoses, Initializer
from slam_init.mapping.resection import resect, triangulate
from slam_init.mapping.views import seen_by
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations, Source, length_of
from slam_init.types.lens import MAX_FOCAL_SIGMA
from slam_init.types.pose import Pose
from slam_init.types.refusal import Verdict
from slam_init.types.result import Result
from slam_init.window.locating import MIN_RESECTED

#: A stretch without a map ends after so many frames: two seconds of video.
LONGEST_STRETCH = 60
#: An estimate of a stretch with a larger relative standard deviation is that of the prior, nearly: it is left out.
_SIGNIFICANT_SIGMA = 0.15
#: A distortion within two of its standard deviations is left out: most images have none.
_SIGNIFICANT_K1_SIGMAS = 2.0
#: What the stretches of a video share: the model has one focal length, two coefficients, and a principal point in the
#: middle, from which real ones are off by a hundredth of the width. With half of a hundredth, the means of two of seven
#: sequences were off by more than three deviations (New Tsukuba by 2.7 %); with this, one is (a nominal calibration).
_MODEL_SIGMA = 0.015
#: What matches the frames of a stretch, its largest number of tracks, and the least numbers of its views and points.
_MATCHER, _MOST_TRACKS, _LEAST_VIEWS, _LEAST_POINTS = "sift", 3000, 6, 100
#: Number of views of a stretch, evenly spaced, beside those whose poses are known. Twice as many take three times as
#: long, and know the focal length no better: what limits it is what the model of the lens lacks.
_MOST_VIEWS = 30
#: Outlier threshold of a view before the lens is known, in pixels: an unknown lens leaves several.
_RESECTION_PX = 8.0
#: Least share of the observations that are no outliers of a fit: a wrong motion or a scene that moves leaves fewer.
_LEAST_INLIERS = 0.6


@dataclass(frozen=True)
class StretchEstimate:
    """The lens by one stretch of a video."""

    #: first_frame, last_frame: Absolute indices.
    first_frame: int
    last_frame: int
    focal_px: float
    #: Relative standard deviation.
    focal_sigma: float
    #: k1, k1_sigma: First coefficient of the radial distortion, in OpenCV's convention, and its standard deviation.
    k1: float
    k1_sigma: float
    #: The second coefficient; 0 where it is no unknown.
    k2: float = 0.0


@dataclass(frozen=True)
class SelfCalibration:
    """The camera by all stretches."""

    #: None where the stretches do not determine the focal length to :data:`slam_init.types.lens.MAX_FOCAL_SIGMA`, the
    #: bound of a map without a calibration.
    camera: Camera | None
    #: Those that determine the focal length.
    stretches: tuple[StretchEstimate, ...]
    #: Number of all stretches.
    tried: int
    #: Standard deviation of the first coefficient of the distortion.
    k1_sigma: float | None = None
    #: Relative standard deviation of the focal length by all stretches; None where no stretch determines it.
    focal_sigma: float | None = None
    #: Without a camera: the most frequent reason of the stretches that end without a map. None otherwise.
    reason: Verdict | None = None
    #: What the person who moves the camera should do about the reason.
    advice: str = ""


def calibrate(
    source: Source,
    camera: Camera,
    config: Config | None = None,
    *,
    start: int = 0,
    max_frames: int | None = None,
    progress: bool = False,
) -> SelfCalibration:
    """Estimate focal length and distortion from a whole video.

    * ``camera``: What is known before, with ``focal_sigma`` (:func:`slam_init.calibration.files.prior_camera`).
    """
    from tqdm import tqdm

    length = length_of(source)
    limits = [limit for limit in (None if length is None else length - start, max_frames) if limit is not None]
    read, total = source.frames(start, max_frames), min(limits, default=None)
    frames = iter(tqdm(read, "calibrating", total, leave=False, unit="frame", disable=not progress))
    ended = (_stretch(source, first, frames, camera, config or Config()) for first in frames)
    stretches = [(found, result.reason, result.advice) for found, result in ended]
    combined = combine(camera, [found for found, _, _ in stretches if found is not None])
    if combined.camera is not None:
        return replace(combined, tried=len(stretches))
    counts = Counter(reason for _, reason, _ in stretches if reason is not None)
    reason = max(counts, key=counts.__getitem__, default=None)
    advice = "" if reason is None else {reason: advice for _, reason, advice in stretches}[reason]
    return replace(combined, tried=len(stretches), reason=reason, advice=advice)


def combine(camera: Camera, estimates: Sequence[StretchEstimate]) -> SelfCalibration:
    """Combine the estimates of independent stretches."""
    if not estimates:
        return SelfCalibration(None, (), 0)
    log_focal, focal_sigma = _mean([math.log(e.focal_px) for e in estimates], [e.focal_sigma for e in estimates])
    k1, k1_sigma = _mean([e.k1 for e in estimates], [e.k1_sigma for e in estimates])
    focal_sigma = math.hypot(focal_sigma, _MODEL_SIGMA)
    if focal_sigma > MAX_FOCAL_SIGMA:
        return SelfCalibration(None, tuple(estimates), len(estimates), k1_sigma, focal_sigma)
    focal_px = math.exp(log_focal)
    found = replace(camera, fx=focal_px, fy=focal_px, source="estimated", focal_sigma=focal_sigma)
    if abs(k1) > _SIGNIFICANT_K1_SIGMAS * k1_sigma:
        found = found.bent(k1 - (camera.distortion[0] if camera.distortion else 0.0))
        # Both coefficients of a stretch belong together, and so do their weights.
        k2, _ = _mean([e.k2 for e in estimates], [e.k1_sigma for e in estimates])
        if k2:
            found = replace(found, distortion=(found.distortion[0], k2, *found.distortion[2:]))
    return SelfCalibration(found, tuple(estimates), len(estimates), k1_sigma, focal_sigma)


def _mean(values: Sequence[float], sigmas: Sequence[float]) -> tuple[float, float]:
    """Weighted mean and its standard deviation, wider where the values scatter more than their deviations say."""
    weights = 1 / np.square(sigmas)
    mean = float(np.average(values, weights=weights))
    sigma = 1 / math.sqrt(float(weights.sum()))
    scatter = float(weights @ np.square(np.subtract(values, mean))) / max(len(values) - 1, 1)
    return mean, sigma * math.sqrt(max(scatter, 1.0))


def _stretch(
    source: Source, first: Frame, frames: Iterator[Frame], camera: Camera, config: Config
) -> tuple[StretchEstimate | None, Result]:
    """The estimate of the frames from the first one to a map, or to the end of the stretch.

    It is that of the most certain window. Where no window determines the focal length, it is that of all frames.
    """
    initializer = Initializer(camera, config)
    for last in chain((first,), frames):
        if isinstance(source, TrackProvider):
            status = initializer.process_tracks(source.observed(last, camera))
        else:
            status = initializer.process(last)
        if status or initializer.frames_read >= LONGEST_STRETCH:
            break
    result = initializer.finish()
    if result.reason == Verdict.UNKNOWN_FOCAL_LENGTH:
        count = last.index - first.index + 1
        found = by_all_frames(source, first.index, count, initializer.motion, camera, config, bar=False)
        if found is not None:
            return found, result
    windows = [attempt.window for attempt in result.attempts if attempt.window is not None]
    best = min(windows, key=lambda window: window.focal_sigma, default=None)
    if best is None or best.focal_sigma > _SIGNIFICANT_SIGMA:
        return None, result
    focal_px = camera.focal_px * best.focal_factor
    k1 = best.distortion_k1 + (camera.distortion[0] if camera.distortion else 0.0)
    return StretchEstimate(first.index, last.index, focal_px, best.focal_sigma, k1, best.distortion_sigma), result


def by_all_frames(
    source: Source, start: int, count: int, motion: FittedPoses | None, camera: Camera, config: Config, *, bar: bool
) -> StretchEstimate | None:
    """The lens by one bundle adjustment of all frames of a stretch; None where it does not determine the focal length.

    The tracks are matches of descriptors. Each image is measured again, so that their errors do not add up: on a road
    they determine the focal length four times as well as tracks of the flow.

    * ``motion``: The poses of some of the frames, and the camera that was fitted with them, as a start.
    * ``camera``: What is known before.
    * ``bar``: Whether to show the progress.
    """
    from tqdm import tqdm

    if motion is None or camera.model not in ("pinhole", "radtan") or any(camera.distortion[2:]):
        return None
    poses, begun = motion
    tracker = make_tracker(begun, replace(config.tracking, matcher=_MATCHER))
    step = math.ceil(count / _MOST_VIEWS)
    for frame in tqdm(source.frames(start, count), "all frames", count, leave=False, unit="frame", disable=not bar):
        if (frame.index - start) % step and frame.index not in poses:
            continue
        if isinstance(source, TrackProvider):
            tracker.history.put(source.observed(frame, begun))
        else:
            tracker.track(frame)
    located = _located(list(tracker.history), poses, begun)
    found = None if located is None else fit_lens(located, begun, camera)
    if found is None or found.inliers < _LEAST_INLIERS or found.focal_sigma > _SIGNIFICANT_SIGMA:
        return None
    last = start + count - 1
    return StretchEstimate(start, last, found.focal_px, found.focal_sigma, found.k1, found.k1_sigma, found.k2)


def _located(views: Sequence[Observations], poses: dict[int, Pose], camera: Camera) -> BundleProblem | None:
    """The frames that those of some known poses locate, with a start of the points of their tracks.

    * ``poses``: Cam_from_world of some frames; others join.
    """
    frames = [view.frame for view in views]
    poses = {frame: pose for frame, pose in poses.items() if frame in frames}
    track_ids, counts = np.unique(np.concatenate([view.track_ids for view in views]), return_counts=True)
    track_ids = track_ids[np.sort(np.argsort(-counts, kind="stable")[:_MOST_TRACKS])]
    pixels, bearings = seen_by([view.through(camera) for view in views], track_ids)
    waiting = [frame for frame in frames if frame not in poses]
    while waiting and len(poses) >= 2:
        near = min(waiting, key=lambda frame: min(abs(frame - known) for known in poses))
        waiting.remove(near)
        points = triangulate([poses[f].inverse() for f in poses], bearings[[frames.index(f) for f in poses]])
        rays = bearings[frames.index(near)]
        both = np.isfinite(points).all(axis=1) & np.isfinite(rays[:, 0])
        nearest = poses[min(poses, key=lambda known: abs(known - near))]
        found = resect(points[both], rays[both], _RESECTION_PX / camera.focal_px, nearest)
        if found is not None and found[1].sum() >= MIN_RESECTED:
            poses[near] = found[0]
    rows, known = [frames.index(frame) for frame in poses], list(poses.values())
    if len(rows) < _LEAST_VIEWS:
        return None
    points = triangulate([pose.inverse() for pose in known], bearings[rows])
    seen = np.isfinite(bearings[rows, :, 0])
    ahead = [np.sum(pose.apply(points) * bearings[row], axis=1) > 0 for pose, row in zip(known, rows, strict=True)]
    good = np.isfinite(points).all(axis=1) & (seen.sum(axis=0) >= 3) & (ahead | ~seen).all(axis=0)
    if good.sum() < _LEAST_POINTS:
        return None
    at, of = np.nonzero(seen[:, good])
    cameras = tuple(pose.inverse() for pose in known)
    return BundleProblem(tuple(poses), cameras, points[good], track_ids[good], at, of, pixels[rows][:, good][at, of])
