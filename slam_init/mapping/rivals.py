"""Comparison of candidate maps: ranking, likelihood margin, difference of poses."""

from __future__ import annotations

import numpy as np

from quest.geometry.quaternion import rotation_angle
from quest.robust.spatial_blocks import directions_of, scatter_of_sum
from slam_init.bundle.problem import BundleSolution
from slam_init.mapping.candidate import MapCandidate
from slam_init.mapping.triangulation import triangulate
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.pose import Pose

__all__ = ["difference_of_maps_deg", "explained_at_most", "margin", "margin_of", "rank", "same_map"]

#: Two adjusted maps that differ by less than both angles are the same map. The angles are about a tenth of the errors
#: that make an initialization wrong.
_SAME_ROTATION_DEG, _SAME_DIRECTION_DEG = 0.3, 2.0
#: Squared residuals are truncated at three standard deviations. Noise exceeds this once in 90 cases, and neither map
#: explains a larger residual.
_VOTING_SIGMAS = 3.0


def margin(camera: Camera, better: MapCandidate, worse: MapCandidate) -> Margin:
    """Compute how clearly the tracks prefer one map to another, in all views that both maps contain.

    Parameters
    ----------
    camera : Camera
    better, worse : MapCandidate
        The margin is positive if the tracks prefer the first one.

    Returns
    -------
    Margin
        Zero if the first map could not be adjusted.
    """
    frames = set(_poses(better)) & set(_poses(worse))
    if not isinstance(better.bundle, BundleSolution):
        return Margin(0.0, 0.0)
    difference = _track_costs(camera, worse, frames, better.bundle.noise_px)
    difference -= _track_costs(camera, better, frames, better.bundle.noise_px)
    return margin_of(difference, directions_of(better.table.bearings[0]))


def margin_of(difference: Floats, where: Floats) -> Margin:
    """Compute the margin of a vote of tracks.

    Neighbouring tracks have errors in common (drift, blur, lens), so that their votes are not independent. The standard
    deviation of the sum is therefore computed from the sums over regions of the view, if that gives a larger value than
    the single tracks do. Four standard deviations require a dozen regions that agree.

    Parameters
    ----------
    difference : (T,) float
        Cost of each track in the worse map minus its cost in the better map.
    where : (T, 2) float
        Coordinates of the tracks in the first view.

    Returns
    -------
    Margin
    """
    total = float(difference.sum())
    scatter = scatter_of_sum(difference, where)
    return Margin(0.5 * total, total / scatter if scatter > 0 else 0.0)


def rank(camera: Camera, candidates: list[MapCandidate]) -> list[MapCandidate]:
    """Sort candidates, the best first.

    A candidate that locates more views comes first. Of candidates with equally many views, the one with the smaller
    cost comes first. The order only determines which candidate is compared with its rivals: the vote
    (:func:`margin`) does not count the number of views.

    Parameters
    ----------
    camera : Camera
    candidates : list of MapCandidate

    Returns
    -------
    list of MapCandidate
        Candidates whose adjustment failed come last.
    """
    solved = [c for c in candidates if isinstance(c.bundle, BundleSolution)]
    failed = [c for c in candidates if not isinstance(c.bundle, BundleSolution)]
    noise_px = min((c.bundle.noise_px for c in solved if isinstance(c.bundle, BundleSolution)), default=1.0)
    frames = set.intersection(*(set(_poses(c)) for c in solved)) if solved else set()
    return sorted(solved, key=lambda c: (-c.placed, float(_track_costs(camera, c, frames, noise_px).sum()))) + failed


def same_map(a: MapCandidate, b: MapCandidate) -> bool:
    """Return whether bundle adjustment brought two candidates to the same map.

    Parameters
    ----------
    a, b : MapCandidate

    Returns
    -------
    bool
    """
    rotation_deg, direction_deg = difference_of_maps_deg(a, b)
    return rotation_deg <= _SAME_ROTATION_DEG and direction_deg <= _SAME_DIRECTION_DEG


def difference_of_maps_deg(a: MapCandidate, b: MapCandidate) -> tuple[float, float]:
    """Compute the difference between the poses of two maps.

    Parameters
    ----------
    a, b : MapCandidate

    Returns
    -------
    rotation_deg : float
        Largest angle between the two rotations of a keyframe.
    direction_deg : float
        Largest angle between the two baselines of a keyframe from the first one. Both angles are infinite if a map
        could not be adjusted, or if the maps have different keyframes.
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
    """Return ``world_from_cam`` by frame: the adjusted poses, or those of the pair if no map could be built."""
    if isinstance(candidate.bundle, BundleSolution):
        problem = candidate.bundle.problem
        return dict(zip(problem.frames, problem.world_from_cam, strict=True))
    first, second = candidate.table.frames[:2]
    return {first: Pose.identity(), second: Pose(candidate.hypothesis.R, candidate.hypothesis.t).inverse()}


def _track_costs(camera: Camera, candidate: MapCandidate, frames: set[int], noise_px: float) -> Floats:
    """Compute the cost (T,) of each track of the table: squared residuals in units of the noise, each truncated.

    The tracks are triangulated again from the poses, so that tracks which one map left out are treated equally in both
    maps. Noise alone may put a point with little parallax behind the cameras. The cost of a point at infinity is then
    smaller, and the smaller one of the two costs is taken.
    """
    table, poses = candidate.table, _poses(candidate)
    bearings = table.bearings
    if isinstance(candidate.bundle, BundleSolution) and candidate.bundle.focal_factor_sigma is not None:
        # The poses belong to the adjusted focal length, and the bearings of the table to the stated one.
        camera = candidate.bundle.camera
        bearings = camera.bearings(table.pixels.reshape(-1, 2)).reshape(bearings.shape)
    rows = [k for k, frame in enumerate(table.frames) if frame in frames]
    placed = [poses[table.frames[k]] for k in rows]
    points = triangulate(placed, bearings[rows])
    # A point at infinity: on the mean ray from the first camera, a million baselines away.
    rays = np.array([pose.R for pose in placed])[:, None] @ np.nan_to_num(bearings[rows])[..., None]
    mean = rays[..., 0].sum(axis=0)
    farthest = max(float(np.linalg.norm(pose.t - placed[0].t)) for pose in placed)
    distant = placed[0].t + 1e6 * max(farthest, 1e-12) * mean / np.linalg.norm(mean, axis=1, keepdims=True)
    costs = []
    for X in (points, distant):
        cost = np.zeros(len(X))
        for k, pose in zip(rows, placed, strict=True):
            r2 = np.sum((camera.project(pose.inverse().apply(X)) - table.pixels[k]) ** 2, axis=1) / noise_px**2
            # NaN means a point behind the camera, or a track that the view does not see.
            cost += np.where(np.isfinite(table.pixels[k, :, 0]), np.fmin(r2, _VOTING_SIGMAS**2), 0.0)
        costs.append(cost)
    seen = np.isfinite(table.pixels[rows, :, 0]).sum(axis=0)
    return np.minimum(np.minimum(*costs), explained_at_most(np.maximum(2 * seen - 3, 0)))


def explained_at_most(freedom: Ints) -> Floats:
    """Return the largest cost of a track that a map explains; larger costs are truncated to it.

    A track that neither of two maps explains must have the same cost in both maps. Otherwise outliers would vote, each
    one by chance but with a large weight. The bound is the mean of chi-square plus five of its standard deviations; one
    correct track in a thousand exceeds it.

    Parameters
    ----------
    freedom : (T,) int
        Degrees of freedom of each track.

    Returns
    -------
    (T,) float
    """
    return np.asarray(freedom + 5 * np.sqrt(2.0 * freedom))
