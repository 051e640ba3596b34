"""Comparison of candidate maps: ranking, likelihood margin, difference of poses."""

from __future__ import annotations

import numpy as np

from quest.geometry.quaternion import rotation_angle
from quest.robust.spatial_blocks import directions_of, scatter_of_sum
from slam_init.bundle.problem import BundleSolution
from slam_init.config import Config
from slam_init.mapping.candidate import MapCandidate
from slam_init.mapping.triangulation import triangulate
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.pose import Pose

__all__ = ["difference_of_maps_deg", "explained_at_most", "margin", "margin_of", "rank", "same_map"]

#: Two adjusted maps nearer than this are one: an order below what makes an initialization wrong.
_SAME_ROTATION_DEG, _SAME_DIRECTION_DEG = 0.3, 2.0

#: A vote counts up to three standard deviations: what lies beyond, one in 90 by noise, is unexplained either way.
_VOTING_SIGMAS = 3.0


def margin(camera: Camera, config: Config, better: MapCandidate, worse: MapCandidate) -> Margin:
    """How clearly the tracks prefer one map to another, in all views that both could place."""
    frames = set(_poses(better)) & set(_poses(worse))
    if not isinstance(better.bundle, BundleSolution):
        return Margin(0.0, 0.0)
    difference = _track_costs(camera, worse, frames, better.bundle.noise_px)
    difference -= _track_costs(camera, better, frames, better.bundle.noise_px)
    return margin_of(difference, directions_of(better.table.bearings[0]))


def margin_of(difference: Floats, where: Floats) -> Margin:
    """The margin of differences of costs (T,) of tracks that were seen at (T, 2) in the first view.

    Neighbours share errors (drift, blur, lens), so that their votes are not independent: the scatter is that of the
    sums over regions of the view, where that is larger than the one of single tracks. Four standard deviations take a
    dozen regions that agree.
    """
    total = float(difference.sum())
    scatter = scatter_of_sum(difference, where)
    return Margin(0.5 * total, total / scatter if scatter > 0 else 0.0)


def rank(camera: Camera, config: Config, candidates: list[MapCandidate]) -> list[MapCandidate]:
    """The candidates in order: those that place more views first, then by what they leave unexplained; failures last.

    The order only says which one the margins are asked of: a map that came first by its views and explains the common
    ones worse decides nothing.
    """
    solved = [c for c in candidates if isinstance(c.bundle, BundleSolution)]
    failed = [c for c in candidates if not isinstance(c.bundle, BundleSolution)]
    noise_px = min((c.bundle.noise_px for c in solved if isinstance(c.bundle, BundleSolution)), default=1.0)
    frames = set.intersection(*(set(_poses(c)) for c in solved)) if solved else set()

    def key(candidate: MapCandidate) -> tuple[int, float]:
        cost = _track_costs(camera, candidate, frames, noise_px).sum()
        return -candidate.placed, float(cost)

    return sorted(solved, key=key) + failed


def same_map(a: MapCandidate, b: MapCandidate) -> bool:
    """Whether two hypotheses ended in the same optimum."""
    rotation_deg, direction_deg = difference_of_maps_deg(a, b)
    return rotation_deg <= _SAME_ROTATION_DEG and direction_deg <= _SAME_DIRECTION_DEG


def difference_of_maps_deg(a: MapCandidate, b: MapCandidate) -> tuple[float, float]:
    """Largest angle between the rotations of two maps, and between their baselines from the first view.

    Infinite where one could not be adjusted, or they have not the same keyframes.
    """
    if not (isinstance(a.bundle, BundleSolution) and isinstance(b.bundle, BundleSolution)):
        return float("inf"), float("inf")
    if a.bundle.problem.frames != b.bundle.problem.frames:
        return float("inf"), float("inf")
    rotations, directions = [], []
    for p, q in zip(a.bundle.problem.world_from_cam[1:], b.bundle.problem.world_from_cam[1:], strict=True):
        rotations.append(float(rotation_angle(p.R.T @ q.R)))
        cosine = float(p.t @ q.t) / max(float(np.linalg.norm(p.t) * np.linalg.norm(q.t)), 1e-300)
        directions.append(float(np.arccos(np.clip(cosine, -1, 1))))
    return float(np.degrees(max(rotations))), float(np.degrees(max(directions)))


def _poses(candidate: MapCandidate) -> dict[int, Pose]:
    """Frame -> world_from_cam: as adjusted, or those of the pair where no map could be built."""
    if isinstance(candidate.bundle, BundleSolution):
        problem = candidate.bundle.problem
        return dict(zip(problem.frames, problem.world_from_cam, strict=True))
    first, second = candidate.table.frames[:2]
    return {first: Pose.identity(), second: Pose(candidate.hypothesis.R, candidate.hypothesis.t).inverse()}


def _track_costs(camera: Camera, candidate: MapCandidate, frames: set[int], noise_px: float) -> Floats:
    """Cost (T,) of each track of the table: squared residuals in units of the noise, each truncated.

    The tracks are triangulated anew from the poses, so that a point which one map left out is judged alike in both. A
    point of little parallax may come out behind the cameras by noise alone: infinity explains it then, and the better
    of the two is taken.
    """
    table, poses = candidate.table, _poses(candidate)
    bearings = table.bearings
    if isinstance(candidate.bundle, BundleSolution) and candidate.bundle.focal_factor_sigma is not None:
        # The poses are those of another camera than the bearings.
        camera = candidate.bundle.camera
        bearings = camera.bearings(table.pixels.reshape(-1, 2)).reshape(bearings.shape)
    rows = [k for k, frame in enumerate(table.frames) if frame in frames]
    placed = [poses[table.frames[k]] for k in rows]
    points = triangulate(placed, bearings[rows])
    # The mean ray from the first camera, a million baselines away.
    rays = np.array([pose.R for pose in placed])[:, None] @ np.nan_to_num(bearings[rows])[..., None]
    mean = rays[..., 0].sum(axis=0)
    farthest = max(float(np.linalg.norm(pose.t - placed[0].t)) for pose in placed)
    distant = placed[0].t + 1e6 * max(farthest, 1e-12) * mean / np.linalg.norm(mean, axis=1, keepdims=True)
    costs = []
    for X in (points, distant):
        cost = np.zeros(len(X))
        for k, pose in zip(rows, placed, strict=True):
            r2 = np.sum((camera.project(pose.inverse().apply(X)) - table.pixels[k]) ** 2, axis=1) / noise_px**2
            # NaN is a point behind the camera, or a track that the view does not see.
            cost += np.where(np.isfinite(table.pixels[k, :, 0]), np.fmin(r2, _VOTING_SIGMAS**2), 0.0)
        costs.append(cost)
    seen = np.isfinite(table.pixels[rows, :, 0]).sum(axis=0)
    return np.minimum(np.minimum(*costs), explained_at_most(np.maximum(2 * seen - 3, 0)))


def explained_at_most(freedom: Ints) -> Floats:
    """Cost of a track with so many degrees of freedom beyond which it counts as not explained, by no more than this.

    Tracks that neither of two maps explains must be the same to both: else wrong matches vote, each by chance but
    heavily. The bound is what one in a thousand right ones exceeds: the mean of chi-square and five of its standard
    deviations.
    """
    return np.asarray(freedom + 5 * np.sqrt(2.0 * freedom))
