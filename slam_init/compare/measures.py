"""How good a map is: against the true poses, the true depths, and the frames that follow."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from slam_init.compare.replay import Step
from slam_init.compare.sources import Judging
from slam_init.evaluation.metrics import compare_with_groundtruth
from slam_init.mapping.triangulation import resect
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose, Trajectory

if TYPE_CHECKING:
    from slam_init.datasets import TimedSource
    from slam_init.datasets.points import PointSource

__all__ = ["DepthErrors", "PoseErrors", "depth_errors", "is_correct", "is_strict", "pose_errors", "survival"]

#: Rotation and direction in degrees: what tracking recovers from, and what needs no recovery.
_CORRECT_DEG = (5.0, 15.0)
_STRICT_DEG = (1.0, 5.0)
#: Frames after the acceptance that the map has to carry; every third is looked at, as neighbours say the same.
_SURVIVAL_FRAMES, _SURVIVAL_STEP = 30, 3
#: A landmark is observed again where its track lies this near to its projection.
_SURVIVAL_PX = 3.0
#: Of two points whose true depths differ by less than this the order means nothing.
_SAME_DEPTH = 0.05


@dataclass(frozen=True)
class PoseErrors:
    """Worst keyframe against the first, and the trajectory after alignment; None where there is no such truth.

    ``ate`` is the root mean square position error after alignment by a similarity, over the length of the true path;
    None for two keyframes, which any similarity aligns.
    """

    rotation_deg: float | None = None
    direction_deg: float | None = None
    ate: float | None = None


@dataclass(frozen=True)
class DepthErrors:
    """Median of ``|depth / (median ratio x true depth) - 1|``, and the share of pairs of points in the wrong order."""

    relative: float | None = None
    wrong_order: float | None = None


def pose_errors(map_: InitialMap, truth: Trajectory | None, *, before: bool = False) -> PoseErrors:
    """Errors of the keyframes after bundle adjustment, or before."""
    keyframes = map_.keyframes
    if before:
        pairs = zip(keyframes, map_.keyframes_before, strict=True)
        keyframes = tuple(replace(keyframe, world_from_cam=pose) for keyframe, pose in pairs)
    figures = compare_with_groundtruth(keyframes, truth)
    if figures is None:
        return PoseErrors()
    ate, length = figures["ate_rmse"], figures["path_length"]
    relative = ate / length if len(keyframes) > 2 and ate is not None and length else None
    return PoseErrors(figures["rotation_error_deg"], figures["direction_error_deg"], relative)


def is_correct(errors: PoseErrors, judging: Judging) -> bool:
    """Within 5 degrees in rotation and 15 in direction; where the camera stays, no map is."""
    return _within(errors, judging, _CORRECT_DEG)


def is_strict(errors: PoseErrors, judging: Judging) -> bool:
    """Within 1 and 5 degrees."""
    return _within(errors, judging, _STRICT_DEG)


def _within(errors: PoseErrors, judging: Judging, bounds_deg: tuple[float, float]) -> bool:
    if judging.still:
        return False
    rotation = errors.rotation_deg is not None and errors.rotation_deg < bounds_deg[0]
    # What the truth does not confirm is not correct.
    direction = errors.direction_deg is not None and errors.direction_deg < bounds_deg[1]
    return rotation and (direction or not judging.direction_known)


def survival(map_: InitialMap, following: Iterable[Step]) -> float | None:
    """Share of the landmarks that the next 30 frames see within 3 px, after resection with the map; median over frames.

    None where no frame follows.
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
        X = guess.apply(map_.points[i])
        # A point behind the camera has no pixel.
        ahead = X[:, 2] > 0
        error_px = np.linalg.norm(camera.project(X[ahead]) - observed.pixels[j][ahead], axis=1)
        shares.append(float(np.sum(error_px < _SURVIVAL_PX)) / max(len(map_.points), 1))
    return float(np.median(shares)) if shares else None


def depth_errors(map_: InitialMap, source: TimedSource | PointSource) -> DepthErrors:
    """Depths of the landmarks in the first keyframe against the truth; both None where the source knows no depth."""
    seen = map_.observation_keyframes == 0
    landmarks = map_.observation_landmarks[seen]
    true = _true_depths(source, map_.keyframes[0].frame, map_.track_ids[landmarks], map_.observation_pixels[seen])
    if true is None:
        return DepthErrors()
    first = map_.keyframes[0].world_from_cam.inverse()
    depth = first.apply(map_.points[landmarks])[:, 2]
    known = np.isfinite(true) & (true > 0)
    if known.sum() < 2:
        return DepthErrors()
    ratio = depth[known] / true[known]
    aligned = ratio / np.median(ratio) if np.median(ratio) > 0 else np.full(len(ratio), np.inf)
    return DepthErrors(_finite(float(np.median(np.abs(aligned - 1)))), _wrong_order(depth[known], true[known]))


def _true_depths(source: TimedSource | PointSource, frame: int, track_ids: Ints, pixels: Floats) -> Floats | None:
    from slam_init.datasets.points import PointSource
    from slam_init.datasets.synth import SynthSource

    if isinstance(source, PointSource):
        return source.sequence.depths(frame)[track_ids]
    if not isinstance(source, SynthSource):
        return None
    _, depth = source.sequence.render(frame)
    column, row = np.round(pixels).astype(int).T
    return np.asarray(depth[np.clip(row, 0, depth.shape[0] - 1), np.clip(column, 0, depth.shape[1] - 1)], float)


def _wrong_order(depth: Floats, true: Floats) -> float | None:
    """Share of pairs with clearly different true depths whose order is wrong; each point with its next ones."""
    wrong, pairs = 0, 0
    for step in range(1, min(len(true), 8)):
        differ: Bools = np.abs(np.log(true[step:] / true[:-step])) > _SAME_DEPTH
        flipped = np.sign(depth[step:] - depth[:-step]) != np.sign(true[step:] - true[:-step])
        wrong, pairs = wrong + int(np.sum(flipped & differ)), pairs + int(differ.sum())
    return wrong / pairs if pairs else None


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
