"""Finds the scale of a map from what is known of the scene."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import get_args

import numpy as np

from slam_init.bundle.metric_graph import joint_pose_covariance
from slam_init.errors import check_type
from slam_init.evaluation.metrics import align_positions
from slam_init.scale.ground import Ground, find_ground
from slam_init.scale.measured_motion import scale_of_motion
from slam_init.scale.planar_target import TargetSize, fit_target
from slam_init.scale.requests import (
    CameraHeight,
    KnownBoard,
    KnownDistance,
    KnownMarkers,
    MeasuredMotion,
    ScaleRequest,
    TrueTrajectory,
    origin_of,
)
from slam_init.scale.sensitivity import inverse_depths
from slam_init.scale.sightings import Sighting, find_board, find_markers
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
#: Positions that agree with a similarity (seven unknowns) tell their noise from four on.
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
    * Returns: Falsy with a reason where the map or the images do not tell it.
    """
    InitialMap.check(map_)
    check_type(request, get_args(ScaleRequest), "the request", "parse_scale(TEXT), as in parse_scale('height:1.65')")
    if images is not None:
        check_type(images, Mapping, "images", "a dict of images by frame")
        for frame, image in _of_keyframes(map_, images).items():
            as_image(image, f"the image of frame {frame}", (map_.camera.width, map_.camera.height))
    for one in located:
        check_type(one, Keyframe, "a located frame", "the Keyframes of frames with known poses")
    if groundtruth is not None:
        check_type(groundtruth, Trajectory, "groundtruth", "a Trajectory")
    if imu is not None:
        check_type(imu, InertialRecord, "imu", "an InertialRecord")
    match request:
        case KnownMarkers():
            return _from_targets(map_, request, find_markers(_of_keyframes(map_, images), request))
        case KnownBoard():
            return _from_targets(map_, request, find_board(_of_keyframes(map_, images), request))
        case CameraHeight():
            return _from_height(map_, request)
        case KnownDistance():
            return _from_distance(map_, request, located)
        case TrueTrajectory():
            return _from_truth(map_, request, located, groundtruth)
        case MeasuredMotion():
            return scale_of_motion(map_, imu, grown)


def _found(request: ScaleRequest, metres_per_unit: float, sigma: float, evidence: str) -> Scale:
    """The scale, unless it is too uncertain."""
    if not (math.isfinite(metres_per_unit) and metres_per_unit > 0 and sigma <= _WORST_SIGMA):
        known = f"to +- {sigma:.0%} only" if math.isfinite(sigma) else "not at all"
        return Scale(
            origin_of(request), reason=f"the scale would be known {known} ({evidence}): move the camera farther"
        )
    return Scale(origin_of(request), float(metres_per_unit), max(float(sigma), _LEAST_SIGMA), evidence)


def _covariance(map_: InitialMap) -> Floats:
    return joint_pose_covariance(map_.graph, map_.values, tuple(keyframe.frame for keyframe in map_.keyframes))


# -- markers and boards -----------------------------------------------------------------------------


def _of_keyframes(map_: InitialMap, images: Mapping[int, Image] | None) -> dict[int, Image]:
    frames = {keyframe.frame for keyframe in map_.keyframes}
    return {frame: image for frame, image in (images or {}).items() if frame in frames}


def _from_targets(map_: InitialMap, request: KnownMarkers | KnownBoard, sightings: Sequence[Sighting]) -> Scale:
    """The common scale of all targets, by generalized least squares on the logarithms of their sizes."""
    what = f"marker of {request.dictionary[:40]}" if isinstance(request, KnownMarkers) else (
        f"board of {request.columns}x{request.rows} inner corners"
    )  # fmt: skip
    length = request.side if isinstance(request, KnownMarkers) else request.square
    origin = origin_of(request)
    if not sightings:
        return Scale(origin, reason=f"no {what} is in the keyframes")
    numbers = sorted({sighting.target for sighting in sightings})
    fits = (fit_target(map_, [one for one in sightings if one.target == number]) for number in numbers)
    sizes = [size for size in fits if size is not None]
    if not sizes:
        return Scale(
            origin, reason=f"no {what} is seen twice in the same place ({len(sightings)} sightings): does it move?"
        )
    covariance = _covariance(map_)
    while True:
        log_units, variance, odd = _combined(sizes, covariance)
        if odd is None:
            break
        if len(sizes) == 2:
            first, second = (f"{size.target}: {math.exp(-size.log_units):.3g} m a unit" for size in sizes)
            return Scale(
                origin, reason=f"two markers tell different scales ({first}, {second}): is their side the same?"
            )
        del sizes[odd]
    used = sum(len(size.frames) for size in sizes)
    frames = {frame for size in sizes for frame in size.frames}
    targets = f"{len(sizes)} target{'s' * (len(sizes) > 1)}"
    evidence = f"{used} of {len(sightings)} sightings of {targets} in {len(frames)} keyframes"
    return _found(request, math.exp(-log_units), math.hypot(math.sqrt(variance), length.relative_sigma), evidence)


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


def _from_height(map_: InitialMap, request: CameraHeight) -> Scale:
    ground = find_ground(map_, nadir=request.nadir)
    if not isinstance(ground, Ground):
        return Scale(origin_of(request), reason=ground.reason)
    variance = ground.variance + float(ground.by_poses @ _covariance(map_) @ ground.by_poses)
    evidence = f"plane of {ground.landmarks} landmarks, tilted by {ground.tilt_deg:.0f} deg"
    sigma = math.hypot(math.sqrt(variance), request.height.relative_sigma)
    return _found(request, request.height.metres / ground.height, sigma, evidence)


def _from_distance(map_: InitialMap, request: KnownDistance, located: Sequence[Keyframe]) -> Scale:
    known = {keyframe.frame: keyframe for keyframe in (*located, *map_.keyframes)}
    frames = request.frames or (map_.keyframes[0].frame, map_.keyframes[-1].frame)
    for frame in frames:
        if frame not in known:
            return Scale(
                origin_of(request), reason=f"frame {frame} is neither a keyframe nor a located one: add --continue N"
            )
    a, b = (known[frame] for frame in frames)
    length = float(np.linalg.norm(b.world_from_cam.t - a.world_from_cam.t))
    if length <= 0:
        return Scale(
            origin_of(request), reason=f"the camera is at the same place in frames {frames[0]} and {frames[1]}"
        )
    sigma = math.hypot(_distance_sigma(map_, a, b), request.distance.relative_sigma)
    return _found(request, request.distance.metres / length, sigma, f"positions of frames {frames[0]} and {frames[1]}")


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


def _from_truth(
    map_: InitialMap, request: TrueTrajectory, located: Sequence[Keyframe], groundtruth: Trajectory | None
) -> Scale:
    origin = origin_of(request)
    if groundtruth is None:
        return Scale(origin, reason="the source has no true trajectory")
    keyframes = (*map_.keyframes, *located)
    pairs = [(k, pose.t) for k in keyframes if (pose := groundtruth.at(k.timestamp_s)) is not None]
    if len(pairs) < 2:
        return Scale(origin, reason=f"the true trajectory has {len(pairs)} of the keyframes: two are needed")
    estimated, true = np.array([k.world_from_cam.t for k, _ in pairs]), np.array([t for _, t in pairs])
    aligned = align_positions(estimated, true)
    spread = aligned.scale * float(np.linalg.norm(estimated - estimated.mean(axis=0)))
    if not spread > 0:
        return Scale(origin, reason="the true camera does not move")
    excess = 3 * len(pairs) - _ALIGNED_UNKNOWNS
    if excess >= 3:
        residuals = true - aligned.apply(estimated)
        sigma = math.sqrt(float(np.sum(residuals**2)) / excess) / spread
    else:
        sigma = _distance_sigma(map_, pairs[0][0], pairs[-1][0])
    return _found(request, aligned.scale, sigma, f"similarity of {len(pairs)} positions")
