"""Finds the scale of a map from what is known of the scene."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TypeAlias, get_args

import numpy as np

from slam_init.bundle.graph import joint_pose_covariance
from slam_init.errors import check_type
from slam_init.evaluation.metrics import align_positions, positions_of, with_true_poses
from slam_init.scale.ground import find_ground
from slam_init.scale.measured_motion import scale_of_motion
from slam_init.scale.planar_target import Sighting, TargetSize, find_board, find_markers, fit_target
from slam_init.scale.requests import (
    CameraHeight,
    KnownBoard,
    KnownDistance,
    KnownMarkers,
    MeasuredMotion,
    NoScaleError,
    ScaleRequest,
    TrueTrajectory,
)
from slam_init.scale.sensitivity import inverse_depths
from slam_init.types.arrays import Floats, Image
from slam_init.types.frame import as_image
from slam_init.types.inertial import InertialRecord
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Trajectory
from slam_init.types.scale import Scale

#: A scale that is known worse than this is none: its interval of two deviations reaches half of the value.
_WORST_SIGMA = 0.25
#: Markers of one size disagree by more than this many standard deviations once in 15,000.
_DISAGREE_SIGMAS = 4.0
#: A relative standard deviation is stated to be no smaller: the range factor of the graph would be a stiff constraint
#: that hinders its optimization (:mod:`slam_init.bundle.graph`).
_LEAST_SIGMA = 1e-3
#: Positions that agree with a similarity (seven unknowns) determine their noise from four on.
_ALIGNED_UNKNOWNS = 7


def find_scale(
    map_: InitialMap,
    request: ScaleRequest,
    *,
    images: Mapping[int, Image] | None = None,
    located: Sequence[Keyframe] = (),
    groundtruth: Trajectory | None = None,
    imu: InertialRecord | None = None,
    grown: InitialMap | None = None,
) -> Scale:
    """Find how many metres a unit of a map is.

    Shapes: ``images`` (H, W).

    * ``request``: What is known, as from :func:`slam_init.scale.requests.parse_scale`.
    * ``images``: Grey images by the absolute index of their frame, for markers and boards. Only keyframes count.
    * ``located``: Frames that were located in the map, for distances and for the true trajectory.
    * ``imu``: The record of an inertial sensor.
    * ``grown``: The same map with the keyframes that were added since, for the inertial sensor.
    * Returns: Falsy with a reason where the map or the images do not determine it.
    """
    InitialMap.check(map_)
    check_type(request, get_args(ScaleRequest), "the request", "parse_scale(TEXT), as in parse_scale('height:1.65')")
    check_type(images or {}, Mapping, "images", "a dict of images by frame")
    frames = {keyframe.frame for keyframe in map_.keyframes}
    images = {frame: image for frame, image in (images or {}).items() if frame in frames}
    for frame, image in images.items():
        as_image(image, f"the image of frame {frame}", (map_.camera.width, map_.camera.height))
    for one in located:
        check_type(one, Keyframe, "a located frame", "the Keyframes of frames with known poses")
    check_type(groundtruth, (Trajectory, type(None)), "groundtruth", "a Trajectory")
    check_type(imu, (InertialRecord, type(None)), "imu", "an InertialRecord")
    try:
        match request:
            case MeasuredMotion():
                return scale_of_motion(map_, imu, grown)
            case KnownMarkers():
                found = _from_targets(map_, request, find_markers(images, request))
            case KnownBoard():
                found = _from_targets(map_, request, find_board(images, request))
            case CameraHeight():
                found = _from_height(map_, request)
            case KnownDistance():
                found = _from_distance(map_, request, located)
            case TrueTrajectory():
                found = _from_truth(map_, (*map_.keyframes, *located), groundtruth)
        metres_per_unit, sigma, evidence = found
        if not (math.isfinite(metres_per_unit) and metres_per_unit > 0 and sigma <= _WORST_SIGMA):
            known = f"to +- {sigma:.0%} only" if math.isfinite(sigma) else "not at all"
            raise NoScaleError(f"the scale would be known {known} ({evidence}): move the camera farther")
    except NoScaleError as why:
        return Scale(request.origin, reason=str(why))
    return Scale(request.origin, float(metres_per_unit), max(float(sigma), _LEAST_SIGMA), evidence)


#: Metres for a unit of the map, the relative standard deviation, and what it was found from.
_Found: TypeAlias = tuple[float, float, str]


def _covariance(map_: InitialMap) -> Floats:
    return joint_pose_covariance(map_.graph, map_.values, tuple(keyframe.frame for keyframe in map_.keyframes))


# -- markers and boards -----------------------------------------------------------------------------


def _from_targets(map_: InitialMap, request: KnownMarkers | KnownBoard, sightings: Sequence[Sighting]) -> _Found:
    """The common scale of all targets, by generalized least squares on the logarithms of their sizes."""
    if not sightings:
        raise NoScaleError(f"no {request} is in the keyframes")
    numbers = sorted({sighting.target for sighting in sightings})
    fits = (fit_target(map_, [one for one in sightings if one.target == number]) for number in numbers)
    sizes = [size for size in fits if size is not None]
    if not sizes:
        raise NoScaleError(f"no {request} is seen twice in the same place ({len(sightings)} sightings): does it move?")
    covariance = _covariance(map_)
    while True:
        log_units, variance, odd = _combined(sizes, covariance)
        if odd is None:
            break
        if len(sizes) == 2:
            first, second = (f"{size.target}: {math.exp(-size.log_units):.3g} m a unit" for size in sizes)
            raise NoScaleError(f"two markers give different scales ({first}, {second}): is their side the same?")
        del sizes[odd]
    used = sum(len(size.frames) for size in sizes)
    frames = {frame for size in sizes for frame in size.frames}
    targets = f"{len(sizes)} target{'s' * (len(sizes) > 1)}"
    evidence = f"{used} of {len(sightings)} sightings of {targets} in {len(frames)} keyframes"
    return math.exp(-log_units), math.hypot(math.sqrt(variance), request.length.relative_sigma), evidence


def _combined(sizes: Sequence[TargetSize], covariance: Floats) -> tuple[float, float, int | None]:
    """The common logarithm of all sizes, its variance, and the position of the one that contradicts the others most."""
    G = np.array([size.by_poses for size in sizes])
    C = G @ covariance @ G.T + np.diag([size.variance for size in sizes])
    logs = np.array([size.log_units for size in sizes])
    weights = np.linalg.solve(C, np.ones(len(sizes)))
    mean, variance = float(weights @ logs / weights.sum()), 1 / float(weights.sum())
    differences = logs - mean
    # Variance of a difference from the mean: C - 1 1^T / sum of the weights.
    sigmas = np.sqrt(np.maximum(np.diag(C) - variance, 1e-12))
    worst = int(np.argmax(np.abs(differences) / sigmas))
    contradicts = len(sizes) > 1 and abs(differences[worst]) > _DISAGREE_SIGMAS * sigmas[worst]
    return mean, variance, worst if contradicts else None


# -- ground, distance, truth ------------------------------------------------------------------------


def _from_height(map_: InitialMap, request: CameraHeight) -> _Found:
    ground = find_ground(map_, nadir=request.nadir)
    variance = ground.variance + float(ground.by_poses @ _covariance(map_) @ ground.by_poses)
    sigma = math.hypot(math.sqrt(variance), request.length.relative_sigma)
    evidence = f"plane of {ground.landmarks} landmarks, tilted by {ground.tilt_deg:.0f} deg"
    return request.length.metres / ground.height, sigma, evidence


def _from_distance(map_: InitialMap, request: KnownDistance, located: Sequence[Keyframe]) -> _Found:
    known = {keyframe.frame: keyframe for keyframe in (*located, *map_.keyframes)}
    first, second = request.frames or (map_.keyframes[0].frame, map_.keyframes[-1].frame)
    for frame in (first, second):
        if frame not in known:
            raise NoScaleError(f"frame {frame} is neither a keyframe nor a located one: add --continue N")
    a, b = known[first], known[second]
    length = float(np.linalg.norm(b.world_from_cam.t - a.world_from_cam.t))
    if length <= 0:
        raise NoScaleError(f"the camera is at the same place in frames {first} and {second}")
    sigma = math.hypot(_distance_sigma(map_, a, b), request.length.relative_sigma)
    return request.length.metres / length, sigma, f"positions of frames {first} and {second}"


def _distance_sigma(map_: InitialMap, a: Keyframe, b: Keyframe) -> float:
    """Relative standard deviation of the distance between two cameras.

    A frame that was located after the initialization moved by a share of the depth, so that the depth counts.
    """
    positions = {keyframe.frame: k for k, keyframe in enumerate(map_.keyframes)}
    covariance = _covariance(map_)
    if a.frame not in positions or b.frame not in positions:
        seen = inverse_depths(map_)
        weights = (seen.values / seen.sigmas) ** 2
        gradient = weights @ (seen.by_poses / seen.values[:, None]) / weights.sum()
        return math.sqrt(float(gradient @ covariance @ gradient) + 1 / float(weights.sum()))
    apart = b.world_from_cam.t - a.world_from_cam.t
    along = apart / float(apart @ apart)
    gradient = np.zeros(len(covariance))
    for keyframe, sign in ((a, -1.0), (b, 1.0)):
        at = 6 * positions[keyframe.frame] + 3
        gradient[at : at + 3] = sign * along @ keyframe.world_from_cam.R
    return math.sqrt(max(float(gradient @ covariance @ gradient), 0.0))


def _from_truth(map_: InitialMap, keyframes: Sequence[Keyframe], truth: Trajectory | None) -> _Found:
    if truth is None:
        raise NoScaleError("the source has no true trajectory")
    pairs = with_true_poses(keyframes, truth)
    if len(pairs) < 2:
        raise NoScaleError(f"the true trajectory has {len(pairs)} of the keyframes: two are needed")
    estimated, true = positions_of(pairs)
    aligned = align_positions(estimated, true)
    spread = aligned.scale * float(np.linalg.norm(estimated - estimated.mean(axis=0)))
    if not spread > 0:
        raise NoScaleError("the true camera does not move")
    excess = 3 * len(pairs) - _ALIGNED_UNKNOWNS
    if excess >= 3:
        residuals = true - aligned.apply(estimated)
        sigma = math.sqrt(float(np.sum(residuals**2)) / excess) / spread
    else:
        sigma = _distance_sigma(map_, pairs[0][0], pairs[-1][0])
    return aligned.scale, sigma, f"similarity of {len(pairs)} positions"
