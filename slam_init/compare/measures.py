"""Quality of a map: errors against the true poses and the true depths, and survival in the frames that follow."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from slam_init.compare.criteria import Criteria, Truth
from slam_init.compare.replay import Step
from slam_init.compare.sources import AnySource
from slam_init.datasets.synth import PointSource, SynthSource
from slam_init.evaluation.metrics import compare_with_groundtruth
from slam_init.mapping.resection import resect
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose, Trajectory

#: Bounds of rotation and direction in degrees. Tracking recovers from errors within the bounds of
#: :mod:`slam_init.compare.criteria`; errors within these bounds need no recovery.
_STRICT_DEG = (1.0, 5.0)
#: Survival is measured on this number of frames after the acceptance. Every third frame is used, because neighbouring
#: frames give nearly the same value.
_SURVIVAL_FRAMES, _SURVIVAL_STEP = 30, 3
#: A landmark is observed again if its track lies within this distance of its projection.
_SURVIVAL_PX = 3.0
#: The order of two points is not compared if the logarithms of their true depths differ by less than this.
_SAME_DEPTH = 0.05


@dataclass(frozen=True)
class PoseErrors:
    """Errors of the poses of the keyframes."""

    #: rotation_deg, direction_deg: Largest error over the keyframes, of the pose relative to the first keyframe:
    #: angle between the rotations, and angle between the directions of the baselines. None if the ground truth does
    #: not hold the value.
    rotation_deg: float | None = None
    direction_deg: float | None = None
    #: Root mean square position error after alignment by a similarity, divided by the length of the true path. None
    #: for two keyframes, because a similarity always aligns two positions exactly.
    ate: float | None = None


def pose_errors(
    map_: InitialMap, truth: Trajectory | None, *, before: bool = False, frames: Collection[int] | None = None
) -> PoseErrors:
    """Compare the keyframes of a map with the true trajectory.

    * ``before``: Use the poses before bundle adjustment instead of the adjusted ones.
    * ``frames``: Frames of the keyframes that are compared; all keyframes by default.
    """
    keyframes = map_.keyframes
    if before:
        pairs = zip(keyframes, map_.keyframes_before, strict=True)
        keyframes = tuple(replace(keyframe, world_from_cam=pose) for keyframe, pose in pairs)
    if frames is not None:
        keyframes = tuple(keyframe for keyframe in keyframes if keyframe.frame in frames)
    figures = compare_with_groundtruth(keyframes, truth)
    if figures is None:
        return PoseErrors()
    ate, length = figures.ate_rmse, figures.path_length
    relative = ate / length if len(keyframes) > 2 and ate is not None and length else None
    return PoseErrors(figures.rotation_error_deg, figures.direction_error_deg, relative)


def is_correct(errors: PoseErrors, criteria: Criteria) -> bool:
    """Return whether the errors of a map are within the bounds of its sequence.

    * ``criteria``: 5 degrees in rotation and 15 degrees in direction for a sound ground truth.
    * Returns: Always False if the camera does not translate, or if the ground truth does not hold the values.
    """
    evaluated = criteria.direction_deg is None or _below(errors.direction_deg, criteria.direction_deg)
    return evaluated and _below(errors.rotation_deg, criteria.rotation_deg) and not criteria.no_translation


def is_strict(errors: PoseErrors, criteria: Criteria) -> bool:
    """Return whether a correct map is also within 1 degree in rotation and within 5 degrees in direction.

    * ``criteria``: The direction is compared with the bound of 5 degrees only if the ground truth is sound.
    """
    rotation_deg, direction_deg = _STRICT_DEG
    resolved = criteria.truth is not Truth.SOUND or _below(errors.direction_deg, direction_deg)
    return resolved and _below(errors.rotation_deg, rotation_deg) and is_correct(errors, criteria)


def _below(error: float | None, bound: float) -> bool:
    """Return whether an error is known and below a bound."""
    return error is not None and error < bound


def survival(map_: InitialMap, following: Iterable[Step]) -> float | None:
    """Measure how many landmarks are observed again in the 30 frames after the acceptance.

    Every third frame is located by resection with the map. A landmark is observed again if its track lies within 3 px
    of its projection.

    * ``following``: Tracks of the frames after the frame at which the map was accepted.
    * Returns: Share of the landmarks that are observed again; median over the frames. None if no frame follows.
    """
    camera = map_.camera
    shares: list[float] = []
    guess: Pose | None = None
    for step in islice(following, _SURVIVAL_STEP - 1, _SURVIVAL_FRAMES, _SURVIVAL_STEP):
        observed = step.current
        i, j, bearings = map_.seen_in(observed)
        resected = resect(map_.points[i], bearings, _SURVIVAL_PX / camera.focal_px, guess)
        if resected is None:
            shares.append(0.0)
            continue
        guess, _ = resected
        # Points that the lens does not see have no projection: their error is NaN.
        error_px = np.linalg.norm(camera.project(guess.apply(map_.points[i])) - observed.pixels[j], axis=1)
        shares.append(float(np.sum(error_px < _SURVIVAL_PX)) / max(len(map_.points), 1))
    return float(np.median(shares)) if shares else None


def depth_errors(map_: InitialMap, source: AnySource) -> tuple[float | None, float | None]:
    """Compare the depths of the landmarks in the first keyframe with the true depths.

    * ``source``: The source of the map. Only synthetic sources hold true depths.
    * Returns: Median of ``|depth / (median ratio x true depth) - 1|``, and the share of the pairs of landmarks in which
      the wrong landmark is the nearer one. None if the true depths are not known.
    """
    seen = map_.observation_keyframes == 0
    landmarks = map_.observation_landmarks[seen]
    true = _true_depths(source, map_.keyframes[0].frame, map_.track_ids[landmarks], map_.observation_pixels[seen])
    known = np.isfinite(true) & (true > 0)
    if known.sum() < 2:
        return None, None
    depth = map_.keyframes[0].world_from_cam.inverse().apply(map_.points[landmarks])[:, 2]
    ratio = depth[known] / true[known]
    aligned = ratio / np.median(ratio) if np.median(ratio) > 0 else np.full(len(ratio), np.inf)
    return float(np.median(np.abs(aligned - 1))), _wrong_order(depth[known], true[known])


def _true_depths(source: AnySource, frame: int, track_ids: Ints, pixels: Floats) -> Floats:
    if isinstance(source, PointSource):
        return source.sequence.depths(frame)[track_ids]
    if not isinstance(source, SynthSource):
        return np.full(len(track_ids), np.nan)
    _, depth = source.sequence.render(frame)
    column, row = np.round(pixels).astype(int).T
    return np.asarray(depth[np.clip(row, 0, depth.shape[0] - 1), np.clip(column, 0, depth.shape[1] - 1)], float)


def _wrong_order(depth: Floats, true: Floats) -> float | None:
    """Return the share of pairs in the wrong order, over pairs with clearly different true depths.

    Each point is paired with up to seven points that follow it.
    """
    wrong, pairs = 0, 0
    for step in range(1, min(len(true), 8)):
        differ: Bools = np.abs(np.log(true[step:] / true[:-step])) > _SAME_DEPTH
        flipped = np.sign(depth[step:] - depth[:-step]) != np.sign(true[step:] - true[:-step])
        wrong, pairs = wrong + int(np.sum(flipped & differ)), pairs + int(differ.sum())
    return wrong / pairs if pairs else None
