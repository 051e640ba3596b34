"""From one two-view hypothesis to an adjusted map with further views, and the comparison of two such maps.

A plane seen in two views has two explanations that fit equally well; each is carried to a map of its own here, and the
views between and around the pair vote by how well its points predict them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from quest.estimate import Hypothesis, RelativePose
from quest.neighbours import directions_of, scatter_of_sum
from quest.quaternion import rotation_angle
from slam_init.bundle import adjust
from slam_init.bundle_noise import min_parallax_rad
from slam_init.bundle_problem import BundleFailure, BundleProblem, BundleSolution
from slam_init.camera import Camera
from slam_init.config import Config, MapConfig
from slam_init.tracks import History, common_tracks
from slam_init.triangulation import resect, triangulate
from slam_init.types import Bools, Floats, Ints, Observations, Pose

__all__ = [
    "MapCandidate",
    "Margin",
    "TrackTable",
    "build_candidate",
    "difference_of_maps_deg",
    "explained_at_most",
    "further_views",
    "margin",
    "margin_of",
    "rank",
    "same_map",
    "table_of",
    "voting_views",
]

#: Two adjusted maps nearer than this are one: an order below what makes an initialization wrong.
_SAME_ROTATION_DEG, _SAME_DIRECTION_DEG = 0.3, 2.0
#: A vote counts up to three standard deviations: what lies beyond, one in 90 by noise, is unexplained either way.
_VOTING_SIGMAS = 3.0


@dataclass(frozen=True, eq=False)
class TrackTable:
    """The tracks common to a pair, as seen in the pair (first two rows) and in further views.

    Attributes
    ----------
    frames : tuple of V int
    track_ids : (T,) int
    pixels : (V, T, 2) float
        NaN where a view does not see a track.
    bearings : (V, T, 3) float
    """

    frames: tuple[int, ...]
    track_ids: Ints
    pixels: Floats
    bearings: Floats


@dataclass(frozen=True, eq=False)
class MapCandidate:
    """A hypothesis that was carried to a map, or why it could not be.

    Attributes
    ----------
    hypothesis : Hypothesis or RelativePose
    bundle : BundleSolution or BundleFailure
    table : TrackTable
    agreement : float
        Share of the landmarks' observations by further views that agree with the two-view map; NaN without any.
    placed : int
        Views that the two-view map could locate, the pair included; those of a short baseline are not in the bundle.
    """

    hypothesis: Hypothesis | RelativePose
    bundle: BundleSolution | BundleFailure
    table: TrackTable
    agreement: float
    placed: int


@dataclass(frozen=True)
class Margin:
    """By how much one map explains the tracks better than another.

    Attributes
    ----------
    log_likelihood : float
        Difference of the truncated Gaussian log-likelihoods, in nats.
    z : float
        The same as a sum over tracks in units of its own fluctuation (Vuong 1989): tracks vote, each by as much as it
        knows, and the scatter of the votes says how far their sum can be trusted.
    z_needed : float
        One chance in 30 000 for a fair coin, where it is not stated otherwise.
    """

    LOG_LIKELIHOOD_NEEDED: ClassVar[float] = 20.0

    log_likelihood: float
    z: float
    z_needed: float = 4.0

    def decides(self) -> bool:
        """Beyond chance, and by odds that a wrong noise level by a factor of two does not turn."""
        return self.share() >= 1

    def share(self) -> float:
        """How far the vote is on its way to a decision; from 1 on it has decided."""
        return min(self.z / self.z_needed, self.log_likelihood / self.LOG_LIKELIHOOD_NEEDED)

    def reversed(self) -> Margin:
        """The same seen from the other map."""
        return replace(self, log_likelihood=-self.log_likelihood, z=-self.z)


def table_of(reference: Observations, current: Observations, further: list[Observations]) -> TrackTable:
    """Gather the tracks that a pair has in common, in all views."""
    i, _ = common_tracks(reference, current)
    track_ids = reference.track_ids[i]
    views = [reference, current, *further]
    pixels = np.full((len(views), len(i), 2), np.nan)
    bearings = np.full((len(views), len(i), 3), np.nan)
    for k, view in enumerate(views):
        _, at, of = np.intersect1d(track_ids, view.track_ids, assume_unique=True, return_indices=True)
        pixels[k, at], bearings[k, at] = view.pixels[of], view.bearings[of]
    return TrackTable(tuple(view.frame for view in views), track_ids, pixels, bearings)


def further_views(
    history: History, reference: Observations, current: Observations, config: MapConfig
) -> list[Observations]:
    """Views that can vote on a pair: evenly spaced over the later part of the motion, else the nearest ones before it.

    A view close to the reference has a short baseline, hence a direction that is badly known: where the tracks moved
    less than ``min_motion_share`` of their way, a view is taken only for lack of a better one.
    """

    def motion_px(view: Observations) -> float:
        i, j = common_tracks(reference, view)
        return float(np.median(np.linalg.norm(view.pixels[j] - reference.pixels[i], axis=1)))

    between = _sharing(history.between(reference.frame, current.frame), reference, current, config.min_resected)
    if between:
        moved = np.array([motion_px(view) for view in between])
        far = config.min_motion_share * motion_px(current)
        late = [view for view, way in zip(between, moved, strict=True) if way >= far]
        views = late or [between[int(np.argmax(moved))]]
        return _evenly_spaced(views, config.max_further_views)
    earlier = _sharing(history.between(-1, reference.frame), reference, current, config.min_resected)
    return earlier[-config.max_further_views :]


def voting_views(
    history: History, reference: Observations, current: Observations, config: MapConfig
) -> list[Observations]:
    """Views for a vote between two maps: from the whole way between the pair, and what lies before it, evenly spaced.

    Other than for a map, a short baseline does no harm: such a view says little, and says so.
    """
    views = (*history.between(-1, reference.frame), *history.between(reference.frame, current.frame))
    return _evenly_spaced(_sharing(views, reference, current, config.min_resected), config.max_voting_views)


def _sharing(
    views: Iterable[Observations], reference: Observations, current: Observations, least: int
) -> list[Observations]:
    """The views that see at least so many of the tracks that a pair has in common."""
    pair_ids = np.intersect1d(reference.track_ids, current.track_ids, assume_unique=True)
    return [v for v in views if len(np.intersect1d(pair_ids, v.track_ids, assume_unique=True)) >= least]


def _evenly_spaced(views: list[Observations], at_most: int) -> list[Observations]:
    """So many of the views at most, the first and the last among them."""
    if not views:
        return []
    picks = np.unique(np.linspace(0, len(views) - 1, at_most).round().astype(int))
    return [views[k] for k in picks]


def build_candidate(
    camera: Camera,
    config: Config,
    table: TrackTable,
    hypothesis: Hypothesis | RelativePose,
    threshold_rad: float | None = None,
) -> MapCandidate:
    """Triangulate the pair, resect the further views, adjust everything.

    Parameters
    ----------
    camera : Camera
    config : Config
    table : TrackTable
    hypothesis : Hypothesis or RelativePose
    threshold_rad : float, optional
        Outliers of a further view are farther off than this; by default that of the configuration.
    """
    if threshold_rad is None:
        threshold_rad = config.two_view.threshold_px / camera.focal_px
    cam2_from_cam1 = Pose(hypothesis.R, hypothesis.t)
    poses = {0: Pose.identity(), 1: cam2_from_cam1.inverse()}  # view -> world_from_cam
    points = triangulate([poses[0], poses[1]], table.bearings[:2])
    usable = hypothesis.inliers & _before_all(points, poses, table)
    usable &= _parallax_rad(points, poses) > min_parallax_rad(camera, config.map.min_noise_px, config.map)
    seen, agreeing = 0, 0
    for k in range(2, len(table.frames)):
        visible = usable & np.isfinite(table.bearings[k, :, 0])
        if visible.sum() < config.map.min_resected:
            continue
        resected = resect(points[visible], table.bearings[k, visible], threshold_rad)
        seen += int(visible.sum())
        if resected is None:
            continue
        cam_from_world, inliers = resected
        agreeing += int(inliers.sum())
        if inliers.sum() >= config.map.min_resected:
            poses[k] = cam_from_world.inverse()
    agreement = agreeing / seen if seen else float("nan")
    placed = len(poses)
    # The tracks' way is a first guess at the baseline, rotation included; now it is known.
    share = {k: float(np.linalg.norm(poses[k].t) / np.linalg.norm(poses[1].t)) for k in poses if k > 1}
    least = config.map.min_motion_share * min(1.0, max(share.values(), default=0.0))
    poses = {k: pose for k, pose in poses.items() if share.get(k, np.inf) >= least}
    # In time order: the first view is the world.
    views = sorted(poses, key=lambda k: table.frames[k])
    first_from_world = poses[views[0]].inverse()
    observed = np.isfinite(table.bearings[views, :, 0]) & usable
    view_index, track_index = np.nonzero(observed)
    kept_tracks = np.flatnonzero(usable)
    position = np.full(len(usable), -1)
    position[kept_tracks] = np.arange(len(kept_tracks))
    problem = BundleProblem(
        frames=tuple(table.frames[k] for k in views),
        world_from_cam=tuple(first_from_world @ poses[k] for k in views),
        points=first_from_world.apply(points[kept_tracks]),
        track_ids=table.track_ids[kept_tracks],
        views=view_index.astype(np.int64),
        landmarks=position[track_index].astype(np.int64),
        pixels=table.pixels[views][observed],
    )
    if len(kept_tracks) < 6:
        bundle: BundleSolution | BundleFailure = BundleFailure(f"only {len(kept_tracks)} points can be triangulated")
    else:
        bundle = adjust(camera, problem, config.map)
    return MapCandidate(hypothesis, bundle, table, agreement, placed)


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


def _before_all(points: Floats, poses: dict[int, Pose], table: TrackTable) -> Bools:
    """Points that lie along their rays, not behind the cameras."""
    before = np.isfinite(points).all(axis=1)
    for k, world_from_cam in poses.items():
        in_camera = world_from_cam.inverse().apply(points)
        before &= np.einsum("ij,ij->i", in_camera, np.nan_to_num(table.bearings[k])) > 0
    return np.asarray(before)


def _parallax_rad(points: Floats, poses: dict[int, Pose]) -> Floats:
    rays = [points - pose.t for pose in (poses[0], poses[1])]
    a, b = (ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays)
    return np.asarray(np.arccos(np.clip(np.einsum("ij,ij->i", a, b), -1, 1)))
