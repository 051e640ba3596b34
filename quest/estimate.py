"""Relative pose of two calibrated views from matches with outliers: pose, depths, alternatives, kind.

:func:`estimate_relative_pose` answers four questions in this order:

1. Which rigid motion explains most matches? RANSAC with small samples, cheirality and local optimization.
2. Does the motion explain more matches than chance would (:mod:`quest.chance`), and is its translation observable
   (:mod:`quest.uncertainty.parallax`)? If not, the kind is "rotation" where a rotation explains more matches than
   chance would, outside each patch of the view too; otherwise there is no pose.
3. Do the points spread beyond a line? If not, there is no pose.
4. Do the points lie on a plane, and does the second motion of the plane explain them as well? If so, the second
   motion is an alternative. Any other mode of RANSAC that explains the matches as well is an alternative too
   (:mod:`quest.alternatives`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.alternatives import as_hypothesis, equivalent_motions, explained_by_plane, more_probable_first
from quest.chance import (
    LARGEST_OF_MOTION,
    LARGEST_OF_ROTATION,
    chance_of_motion,
    false_alarms_beside_rotation,
    false_alarms_of_rotation,
)
from quest.covariance import planar_pose_covariance, plane_of_pose, pose_covariance
from quest.errors import InputError, as_floats, as_index, as_positive
from quest.geometry.epipolar import as_matches
from quest.geometry.quaternion import quaternion_from_matrix
from quest.noise import GATE_SIGMAS, MOST_COMPARED, best_of_modes, refine_with_noise
from quest.relative_pose import Hypothesis, NoPose, PoseEvidence, RelativePose
from quest.robust import kernels
from quest.robust.lo_ransac import QUEST_FIVE, Options, Proposer, lo_ransac
from quest.robust.plane import PlaneFit, fit_plane
from quest.robust.pose_problem import PoseProblem, distinct_modes, spread_out
from quest.robust.rotation import propose_rotation, settle_rotation
from quest.uncertainty.parallax import ParallaxStatement, as_direction, as_rotation, statement_of_inliers

__all__ = ["Hypothesis", "NoPose", "PoseEvidence", "RelativePose", "estimate_relative_pose", "refine_relative_pose"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: A rotation-only camera is called a moving one at most once in ten thousand times.
_ERROR_RATE = 1e-4
#: Smallest noise, as a share of the threshold, that is used where the parallax is tested. Most matches of a static
#: camera agree to some hundredths of a pixel, a few do not, and so long a tail is not Gaussian.
_LEAST_NOISE = 0.05
#: A motion always fits the five to seven matches that it was computed from. With fewer than ten matches, too few others
#: remain to confirm it: of 360 simulated cameras that only rotate, 2 showed a translation by eight matches, none by
#: ten.
_MIN_MATCHES = 10
#: Share of the matches that a rotation explains at least.
_LEAST_SHARE = 0.25
#: Points along a line allow a whole family of motions. Over 48 strips of points the pose was wrong by degrees wherever
#: their half width was under ten times the noise, and it was among the returned ones from fifteen times on.
_LINE_SIGMAS = 10.0
#: Any six numbers without a relation between them.
_GENERIC_AXIS = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0])


class _Motion(NamedTuple):
    """The best motion (q_wxyz, t), the matches (m, n) that it explains, the noise and the gate of its inliers."""

    model: Floats
    inliers: Bools
    m: Floats
    n: Floats
    noise_rad: float
    gate_rad: float


class _Rotation(NamedTuple):
    """A rotation (3, 3), its residuals r2 and inliers, and how many rotations explain as many by chance.

    * ``false_alarms_anywhere, false_alarms``: All over the view, and outside each patch too.
    """

    R: Floats
    r2: Floats
    inliers: Bools
    false_alarms_anywhere: float
    false_alarms: float

    @property
    def counts(self) -> bool:
        """Whether it explains many matches, more than chance would, and outside each patch too."""
        # Points of equal depth all over the view turn alike where the camera moves: they are no chance, but a part.
        least = max(_MIN_MATCHES, _LEAST_SHARE * len(self.inliers))
        return bool(self.inliers.sum() >= least and self.false_alarms <= LARGEST_OF_ROTATION)


def estimate_relative_pose(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    *,
    threshold_rad: float = 2e-3,
    seed: int = 0,
    confidence: float = 0.999,
    max_samples: int = 50_000,
    scores: ArrayLike | None = None,
    initial_pose: tuple[ArrayLike, ArrayLike] | None = None,
) -> RelativePose | NoPose:
    """Estimate the motion between two calibrated views from matches with outliers.

    Parameters
    ----------
    bearings1, bearings2 : (N, 3) array_like
        Matched rays in camera 1 and camera 2, of any length but zero.
    threshold_rad : float
        A match whose Sampson error is larger is an outlier, in radians: about three times the standard deviation of a
        bearing. The threshold is lowered where the data turn out to be less noisy.
    seed : int
        Seed of the random samples. The same data and seed give the same result.
    confidence : float
        Probability with which RANSAC finds the best motion.
    max_samples : int
        Bound on the number of samples, hence on the time: three to ten microseconds each. 50 000 samples find a motion
        among 80 % of outliers.
    scores : (N,) array_like, optional
        Quality of the matches, higher is better (for example minus the descriptor distance). Better matches are sampled
        first.
    initial_pose : (q_or_R, t), optional
        A pose cam2_from_cam1 to begin with, as from a motion model: its rotation as a quaternion wxyz or a matrix, and
        its translation of any norm but zero. Samples are taken until a better one would have been found, so a good
        start saves most of them. :func:`quest.refine_relative_pose` draws none.

    Returns
    -------
    RelativePose or NoPose
        A truthy result holds ``R, t = cam2_from_cam1`` with ``u R m + t = v n``. A falsy result holds the reason.

    Raises
    ------
    InputError
        If the shapes differ or are not (N, 3), a bearing is zero or not finite, or another argument is not one of the
        above.

    References
    ----------
    .. [F17] K. Fathian et al., "Quaternion Based Camera Pose Estimation From Matched Feature Points", 2017.
    """
    m, n = as_unit_bearings(bearings1, bearings2)
    options = checked_options(len(m), threshold_rad, seed, confidence, max_samples, scores)
    start = None if initial_pose is None else _checked_pose(initial_pose)
    return pose_of_bearings(m, n, options, start)


def pose_of_bearings(
    m: Floats,
    n: Floats,
    options: Options,
    start: tuple[Floats, Floats] | None = None,
    proposer: Proposer = QUEST_FIVE,
) -> RelativePose | NoPose:
    """Estimate the motion of checked unit bearings (N, 3), see :func:`estimate_relative_pose`."""
    threshold_rad = options.threshold_rad
    rng = np.random.default_rng(options.seed)
    total = len(m)
    distinct = _distinct(m, n)
    if distinct < _MIN_MATCHES:
        return NoPose("too_few_matches", PoseEvidence(distinct, needed=_MIN_MATCHES))
    rotation = propose_rotation(m, n, threshold_rad, rng)
    problem = PoseProblem(m, n, threshold_rad)
    report = lo_ransac(problem.m, problem.n, options, rng, start, proposer)
    if report is None:
        # Every sample was singular, as for an exact rotation-only camera.
        return _rotation_or_no_pose(_rotation_of(problem, rotation, rng), PoseEvidence(total))

    found = int(problem.explained(report.models[0], threshold_rad).sum())
    best, noise_rad, others = best_of_modes(problem, report, found, rng)
    gate_rad = min(threshold_rad, GATE_SIGMAS * noise_rad)
    inliers = problem.explained(best, gate_rad)
    motion = _Motion(best, inliers, m[inliers], n[inliers], noise_rad, gate_rad)
    count = len(motion.m)
    chance = chance_of_motion(problem, best, gate_rad, rng)
    evidence = PoseEvidence(
        total,
        samples=report.samples,
        inliers=count,
        noise_rad=noise_rad,
        chance_inliers=chance.inliers,
        false_alarms=chance.false_alarms,
    )
    if count < _MIN_MATCHES or chance.false_alarms > LARGEST_OF_MOTION:
        return _rotation_or_no_pose(_rotation_of(problem, rotation, rng), evidence)
    parallax = _tested_parallax(problem, motion, chance.inliers, rotation)
    evidence = evidence.extended(parallax_z=parallax.test_value, parallax_p=parallax.p_value)
    if not parallax.observable(_ERROR_RATE):
        turned = _rotation_of(problem, rotation, rng)
        # Where a rotation explains no more than chance would, the camera does not only rotate. Where it explains only a
        # patch, or a few far points, the rest decides.
        if turned.counts or (
            turned.false_alarms_anywhere <= LARGEST_OF_ROTATION
            and false_alarms_beside_rotation(problem, best, turned.r2, chance.shares) > LARGEST_OF_MOTION
        ):
            return _rotation_or_no_pose(turned, evidence, parallax, _unobserved_motions(problem, motion))
    spread = kernels.off_line(motion.m, GATE_SIGMAS)
    if spread < _LINE_SIGMAS * noise_rad:
        spread = max(spread, kernels.off_line(motion.n, GATE_SIGMAS))
        if spread < _LINE_SIGMAS * noise_rad:
            return NoPose("no_consistent_motion", evidence.extended(off_line_rad=spread))
    return _pose_with_alternatives(problem, others, motion, evidence, parallax)


def refine_relative_pose(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    initial_pose: tuple[ArrayLike, ArrayLike],
    *,
    threshold_rad: float = 2e-3,
    seed: int = 0,
) -> RelativePose | NoPose:
    """Refine a known motion between two calibrated views on matches with outliers.

    Parameters
    ----------
    bearings1, bearings2 : (N, 3) array_like
        Matched rays in camera 1 and camera 2, of any length but zero.
    initial_pose : (q_or_R, t)
        The pose cam2_from_cam1 to begin with: its rotation as a quaternion wxyz or a matrix, and its translation of any
        norm but zero. Refinement takes it to the optimum where it explains a part of the matches within twice the
        threshold.
    threshold_rad : float
        A match whose Sampson error is larger is an outlier, in radians.
    seed : int
        Seed of the subsets to which the pose is refitted.

    Returns
    -------
    RelativePose or NoPose
        As of :func:`quest.estimate_relative_pose`, with kind, alternatives (of a plane), parallax and covariance.

    Raises
    ------
    InputError
        If the pose is none, or another argument is refused by :func:`quest.estimate_relative_pose`.
    """
    start = _checked_pose(initial_pose)
    return estimate_relative_pose(
        bearings1, bearings2, threshold_rad=threshold_rad, seed=seed, max_samples=0, initial_pose=start
    )


def estimate_relative_poses(
    pairs: Iterable[tuple[ArrayLike, ArrayLike]], *, threads: int = 1, **options: Any
) -> list[RelativePose | NoPose]:
    """Estimate the motion of each pair of views.

    Parameters
    ----------
    pairs : iterable of (bearings1, bearings2)
        Matched rays (N, 3) of each pair; N may differ.
    threads : int
        Number of pairs at a time. The results do not depend on it.
    **options
        Of :func:`quest.estimate_relative_pose`, the same for all pairs.

    Returns
    -------
    list of RelativePose or NoPose
        In the order of the pairs.

    Raises
    ------
    InputError
        If threads is not a number from 1, or a pair or an option is refused.
    """
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(as_index(threads, "threads", 1)) as pool:
        return list(pool.map(lambda pair: estimate_relative_pose(*pair, **options), pairs))


def _checked_pose(initial_pose: tuple[ArrayLike, ArrayLike]) -> tuple[Floats, Floats]:
    if not (isinstance(initial_pose, tuple) and len(initial_pose) == 2):
        raise InputError("initial_pose is no pair: give (R, t) or (q_wxyz, t)")
    return np.array(as_rotation(initial_pose[0]), order="C"), as_direction(initial_pose[1])


def as_unit_bearings(bearings1: ArrayLike, bearings2: ArrayLike) -> tuple[Floats, Floats]:
    """Check matched rays, and scale copies of them (N, 3) to unit norm."""
    rays1, rays2 = as_floats(bearings1, "bearings"), as_floats(bearings2, "bearings")
    if rays1.shape == rays2.shape and rays1.ndim == 2 and rays1.shape[1] == 3:
        # Copies, so that the compiled loop meets one kind of array: writable, with contiguous rows.
        m, n = np.array(rays1, order="C"), np.array(rays2, order="C")
        if kernels.unit_rows(m, m) and kernels.unit_rows(n, n):
            return m, n
    m, n = as_matches(rays1, rays2, at_least=0)
    if m.ndim != 2:
        raise InputError(f"bearings have shape {m.shape}: give two arrays (N, 3)")
    return m, n


def checked_options(
    count: int,
    threshold_rad: float,
    seed: int,
    confidence: float,
    max_samples: int,
    scores: ArrayLike | None = None,
) -> Options:
    """Check the arguments beside the bearings."""
    threshold_rad = as_positive(threshold_rad, "threshold_rad", "a positive angle in radians")
    if threshold_rad > 1:
        raise InputError(f"threshold_rad is {threshold_rad:g}: give an angle of at most 1 rad")
    if not as_positive(confidence, "confidence", "a probability between 0 and 1") < 1:
        raise InputError(f"confidence is {confidence!r}: give a probability between 0 and 1")
    max_samples = as_index(max_samples, "max_samples", 0)
    ranking = None if scores is None else _checked_scores(scores, count)
    return Options(threshold_rad, as_index(seed, "seed", 0), confidence, max_samples, ranking)


def _checked_scores(scores: ArrayLike, count: int) -> Floats:
    ranking = as_floats(scores, "scores")
    if ranking.shape != (count,) or np.isnan(ranking).any():
        raise InputError(f"scores have shape {ranking.shape}: give a number for each of the {count} matches")
    return ranking


def _distinct(m: Floats, n: Floats) -> int:
    """Number of different matches, at most as many as are needed: a repeated match is no additional evidence."""
    # Equal rows have equal projections. Different rows have practically never the same projection on a generic axis.
    places = m @ _GENERIC_AXIS[:3] + n @ _GENERIC_AXIS[3:]
    some = len(set(places[: 4 * _MIN_MATCHES].tolist()))
    return some if some >= _MIN_MATCHES else len(np.unique(places))


def _tested_parallax(problem: PoseProblem, motion: _Motion, chance: float, rotation: Floats) -> ParallaxStatement:
    """Test whether the translation of a motion is observable on its inliers."""
    least_noise_rad = _LEAST_NOISE * problem.threshold_rad
    return statement_of_inliers(
        kernels.rotation_of_model(motion.model),
        motion.model[4:],
        motion.m,
        motion.n,
        least_noise_rad if motion.noise_rad < least_noise_rad else None,
        chance_matches=chance,
        wrong_matches=len(problem) - len(motion.m),
        rotation=rotation,
        stated_noise_rad=problem.threshold_rad / GATE_SIGMAS,
    )


def _pose_with_alternatives(
    problem: PoseProblem, others: list[Floats], motion: _Motion, evidence: PoseEvidence, parallax: ParallaxStatement
) -> RelativePose | NoPose:
    """The pose of a motion with observable translation, its kind, and the motions that explain the matches as well."""
    gate_rad, noise_rad, best, inliers = motion.gate_rad, motion.noise_rad, motion.model, motion.inliers
    plane = fit_plane(best, motion.m, motion.n, noise_rad)
    evidence = evidence.extended(on_plane=plane.on, off_plane=plane.off)
    planar = explained_by_plane(problem, plane, best, len(motion.m))
    if planar:
        # The two poses of the homography: with the constraint of the plane they are several times more accurate than
        # poses from epipolar lines alone.
        best, *candidates = more_probable_first(problem, plane, motion.noise_rad)
        inliers = problem.explained(best, gate_rad)
        # With rays in all directions, this motion may place so many points behind a camera that fewer than ten inliers
        # remain.
        if inliers.sum() < _MIN_MATCHES:
            return NoPose("no_consistent_motion", evidence)
    else:
        candidates = _competing(problem, others, motion, plane)
    alternatives = equivalent_motions(problem, candidates, best, gate_rad)
    first = as_hypothesis(best, inliers)
    depths, parallax_rad = kernels.depths_and_parallax(problem.m, problem.n, first.R, first.t, inliers)
    outliers = 1 - float(inliers.mean())
    if planar:
        k, on_plane = plane_of_pose(first, problem.m[inliers], problem.n[inliers], noise_rad)
        H = first.R + np.outer(first.t, k)
        on = np.flatnonzero(inliers)[on_plane]
        covariance = planar_pose_covariance(first, problem.m[on], problem.n[on], noise_rad, outliers)
    else:
        H, covariance = None, pose_covariance(first, motion.m, motion.n, noise_rad, outliers)
    return RelativePose(
        q_wxyz=first.q_wxyz,
        R=first.R,
        t=first.t,
        inliers=inliers,
        depths1=depths[0],
        depths2=depths[1],
        kind="planar" if planar else "general",
        alternatives=tuple(alternatives),
        noise_rad=noise_rad,
        parallax_rad=parallax_rad,
        parallax=parallax,
        covariance=covariance,
        evidence=evidence,
        H=H,
    )


def _competing(problem: PoseProblem, others: list[Floats], motion: _Motion, plane: PlaneFit) -> list[Floats]:
    """Other motions of a scene that is no plane, each refined to its optimum on all matches."""
    far = spread_out(others, motion.model)
    # Of few matches, the choice between the modes has refined all others on all matches.
    refined = far if len(problem) <= MOST_COMPARED else []
    return [refine_with_noise(problem, model)[0] for model in (*plane.poses[1:], *far[len(refined) :])] + refined


def _unobserved_motions(problem: PoseProblem, motion: _Motion) -> tuple[Hypothesis, ...]:
    """The best motion and those of its plane, although the matches do not show their translation."""
    plane = fit_plane(motion.model, motion.m, motion.n, motion.noise_rad)
    models = [motion.model, *plane.poses]
    if explained_by_plane(problem, plane, motion.model, len(motion.m)):
        models = [*more_probable_first(problem, plane, motion.noise_rad), motion.model]
    return tuple(as_hypothesis(model, problem.explained(model, motion.gate_rad)) for model in distinct_modes(models))


def _rotation_of(problem: PoseProblem, rotation: Floats, rng: np.random.Generator) -> _Rotation:
    """The rotation that explains most matches, refined from a first estimate, and whether chance explains as many."""
    R = settle_rotation(rotation, problem.m, problem.n, problem.threshold_rad)
    r2 = 0.5 * np.sum((problem.n - problem.m @ R.T) ** 2, axis=1)
    # The residual of a rotation has two components, the Sampson error has one: the gate per component is the same.
    near = r2 < 2 * problem.threshold_rad**2
    gate_rad = min(problem.threshold_rad, GATE_SIGMAS * _noise_of_rotation(r2[near])) if near.any() else 0.0
    inliers = r2 < 2 * gate_rad**2
    anywhere, off_patch = false_alarms_of_rotation(problem, R, inliers, rng)
    return _Rotation(R, r2, inliers, anywhere, max(anywhere, off_patch))


def _noise_of_rotation(r2: Floats) -> float:
    return float(np.sqrt(kernels.median_in_place(r2.copy()) / (2 * np.log(2))))  # Rayleigh: median^2 = 2 ln 2 sigma^2


def _rotation_or_no_pose(
    rotation: _Rotation,
    evidence: PoseEvidence,
    parallax: ParallaxStatement | None = None,
    unobserved: tuple[Hypothesis, ...] = (),
) -> RelativePose | NoPose:
    """The pose of kind "rotation" if a rotation explains many matches, outside a patch too; otherwise no pose."""
    inliers = rotation.inliers
    evidence = evidence.extended(rotation_inliers=int(inliers.sum()))
    if not rotation.counts:
        return NoPose("no_consistent_motion", evidence)
    nan = np.full(len(inliers), np.nan)
    noise_rad = _noise_of_rotation(rotation.r2[inliers])
    return RelativePose(
        q_wxyz=quaternion_from_matrix(rotation.R),
        R=rotation.R,
        t=np.zeros(3),
        inliers=inliers,
        depths1=nan,
        depths2=nan.copy(),
        kind="rotation",
        alternatives=unobserved,
        noise_rad=noise_rad,
        parallax_rad=0.0,
        parallax=parallax,
        covariance=np.full((5, 5), np.nan),
        evidence=evidence.extended(false_alarms=rotation.false_alarms),
        H=rotation.R,
    )
