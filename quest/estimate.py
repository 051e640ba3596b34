"""Relative pose of two calibrated views from matches with outliers: pose, depths, alternatives, kind.

The order of the function :func:`estimate_relative_pose` is the order of the questions:

1. Which rigid motion explains most matches? Small samples, cheirality, locally optimized RANSAC.
2. Is its translation observable (:mod:`quest.uncertainty.parallax`)? Else the kind is "rotation", where a rotation explains a
   quarter of the matches, and there is no pose where it does not.
3. Is the motion more than chance would explain, and do the points spread beyond a line? Else there is no pose.
4. Do the points lie on a plane, and does the plane's twin explain them as well? Then the twin is an alternative. Any
   other mode that RANSAC met and that explains the matches as well is one too.

"As well" has two sides. No significant number of matches may be explained by one motion only: a count, compared with
its fluctuation (:func:`decides`). And the residuals of those that both explain may not be larger: a sum of truncated
squares, compared with its scatter over regions of the view, so that one body or a part of the lens does not decide. A
plane's two motions have the same residuals: between them the counts alone speak.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError, as_floats, as_index, as_positive
from quest.geometry.epipolar import as_matches, depths_from_pose
from quest.geometry.quaternion import canonical, matrix_from_quaternion, quaternion_from_matrix
from quest.geometry.refine import sampson_jacobian
from quest.relative_pose import Hypothesis, NoPose, RelativePose
from quest.robust.lo_ransac import search_five
from quest.robust.plane import PlaneFit, fit_plane, off_line_rad
from quest.robust.pose_modes import same_mode, spread_out
from quest.robust.pose_problem import SAMPLERS, CompiledPoseProblem, RelativePoseProblem
from quest.robust.ransac import RansacReport, ransac
from quest.robust.rotation import fit_rotation
from quest.robust.spatial_blocks import directions_of, scatter_of_sum
from quest.uncertainty.parallax import ParallaxStatement, parallax_statement, typical_ratios

__all__ = ["Hypothesis", "NoPose", "RelativePose", "decides", "estimate_relative_pose"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: A Gaussian error exceeds three standard deviations in 0.3 % of the cases.
_GATE_SIGMAS = 3.0
#: A camera that only turned is said to have moved once in ten thousand times at most.
_ERROR_RATE = 1e-4
#: Noise below this share of the threshold is not believed where the parallax is tested: matches of a still camera agree
#: to some hundredths of a pixel but for a few, and a tail that long is not Gaussian.
_LEAST_NOISE = 0.05
#: Fewer than this many matches cannot confirm a motion of five unknowns that five to seven matches proposed.
_MIN_MATCHES = 10
#: Points along a line allow a whole family of motions. Over 48 strips of points the pose was wrong by degrees wherever
#: their half width was under ten times the noise, and it was among the returned ones from fifteen times on.
_LINE_SIGMAS = 10.0
#: Any six numbers without a relation between them.
_GENERIC_AXIS = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0])
#: Ratio of residuals along and across the epipolar lines up to which points lie on a plane: relief as large as the
#: noise makes 1.4. For few matches it is four standard deviations of the ratio of two medians, 1.65 / sqrt(N) each.
_FLAT = 1.5
#: How much worse a motion's residuals must be, in noise variances and in standard deviations of their sum. Five
#: unknowns bring the cost down by chi-square of five degrees of freedom: by 26 once in 10 000, by 15 once in a hundred.
#: A rival is dropped for good, so beyond doubt; a plane is only preferred, so it has to be as good as the free motion.
_RIVAL_LEVEL = (26.0, 4.0)
_PLANE_LEVEL = (15.0, 2.5)


def decides(votes_for: int, votes_against: int, total: int, scatter: float | None = None) -> bool:
    """Whether counts of matches that only one of two hypotheses explains decide between them.

    Under the null hypothesis that neither is better, each such vote is a fair coin, and the difference has the standard
    deviation sqrt(for + against): four of them are exceeded once in 30 000. Votes that come from one small moving
    object or a repeated texture are not independent: their ``scatter`` (:mod:`quest.robust.spatial_blocks`) takes its place where
    it is known. Twelve votes, and 3 % of all matches, are asked for besides: fewer may lie in regions of their own and
    still be one repeated texture.
    """
    difference = votes_for - votes_against
    deviation = float(np.sqrt(votes_for + votes_against)) if scatter is None else scatter
    return bool(difference >= max(12.0, 0.03 * total, 4.0 * deviation))


def estimate_relative_pose(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    *,
    threshold_rad: float = 2e-3,
    seed: int = 0,
    confidence: float = 0.999,
    max_samples: int = 50_000,
    scores: ArrayLike | None = None,
    solver: str = "five",
) -> RelativePose | NoPose:
    """Estimate the motion between two calibrated views from matches that hold outliers.

    Parameters
    ----------
    bearings1, bearings2 : (N, 3) array_like
        Matched rays in camera 1 and camera 2, any non-zero length.
    threshold_rad : float
        A match farther than this from its epipolar geometry (Sampson error) is an outlier, in radians: about three
        times the standard deviation of a bearing. It is lowered where the data turn out to be less noisy.
    seed : int
        Same data and seed, same result.
    confidence : float
        With which RANSAC finds the best motion.
    max_samples : int
        Bound on the number of samples, hence on the time: about ten microseconds each. 50 000 find a motion among 80 %
        of outliers.
    scores : (N,) array_like, optional
        Quality of the matches, higher is better (minus the descriptor distance, say): the better ones are drawn first.
        Used by the solver "five" alone.
    solver : {"five", "quest6", "quest7"}
        What proposes motions: Newton's method on five matches, compiled; or the eigenproblems of QuEst on six or
        seven, in plain numpy, at some hundred microseconds a sample.

    Returns
    -------
    RelativePose or NoPose
        See there. Where it is truthy, ``u R m + t = v n`` with ``R, t = cam2_from_cam1``.

    Raises
    ------
    InputError
        Where the shapes differ or are not (N, 3), a bearing is zero or not finite, or another argument is none of the
        above.

    References
    ----------
    .. [F17] K. Fathian et al., "Quaternion Based Camera Pose Estimation From Matched Feature Points", 2017.
    """
    m, n = _unit_bearings(bearings1, bearings2)
    threshold_rad = as_positive(threshold_rad, "threshold_rad", "a positive angle in radians")
    if threshold_rad > 1:
        raise InputError(f"threshold_rad is {threshold_rad:g}: give an angle of at most 1 rad")
    if not as_positive(confidence, "confidence", "a probability between 0 and 1") < 1:
        raise InputError(f"confidence is {confidence!r}: give a probability between 0 and 1")
    max_samples = as_index(max_samples, "max_samples", 0)
    ranking = None if scores is None else _ranking(scores, len(m))
    if not (isinstance(solver, str) and solver in ("five", *SAMPLERS)):
        raise InputError(f"solver is {solver!r:.60}: give one of five, {', '.join(SAMPLERS)}")
    rng = np.random.default_rng(as_index(seed, "seed", 0))
    total = len(m)
    distinct = _distinct(m, n)
    if distinct < _MIN_MATCHES:
        return NoPose("too_few_matches", {"matches": distinct, "needed": _MIN_MATCHES})
    R0, rotation_r2 = fit_rotation(m, n, threshold_rad, rng)
    problem: RelativePoseProblem
    report: RansacReport | None
    if solver == "five":
        problem = CompiledPoseProblem(m, n, threshold_rad)
        report = search_five(
            problem.m, problem.n, threshold_rad, rng, R0, confidence=confidence, max_samples=max_samples, scores=ranking
        )
    else:
        problem = RelativePoseProblem(m, n, threshold_rad, solver)
        report = ransac(problem, rng, confidence=confidence, max_samples=max_samples)
    if report is None:
        # Every sample was singular, as exact pure rotations are.
        return _rotation_or_nothing(R0, rotation_r2, threshold_rad, total, {"matches": total})

    best, noise_rad = _tighten(problem, report.models[0])
    gate_rad = min(threshold_rad, _GATE_SIGMAS * noise_rad)
    inliers = problem.explained(best, gate_rad)
    floor_rad = _LEAST_NOISE * threshold_rad
    evidence: dict[str, float] = {
        "matches": total,
        "samples": report.samples,
        "inliers": int(inliers.sum()),
        "noise_rad": noise_rad,
    }

    if evidence["inliers"] < 6:
        return _rotation_or_nothing(R0, rotation_r2, gate_rad, total, evidence)
    chance = _chance_inliers(problem, best, gate_rad, rng)
    parallax = parallax_statement(
        best[:4],
        best[4:],
        m[inliers],
        n[inliers],
        floor_rad if noise_rad < floor_rad else None,
        chance_matches=chance,
        wrong_matches=total - int(inliers.sum()),
        rotation=R0,
    )
    evidence |= {"chance_inliers": chance, "parallax_z": parallax.test_value, "parallax_p": parallax.p_value}
    if not parallax.observable(_ERROR_RATE):
        return _rotation_or_nothing(R0, rotation_r2, gate_rad, total, evidence, parallax)
    # Five or six inliers are the sample's own; the best of thousands of random motions lies about four standard
    # deviations above the mean of a Poisson count.
    if inliers.sum() < max(_MIN_MATCHES, 6 + chance + 4 * np.sqrt(chance + 1)):
        return NoPose("no_consistent_motion", evidence)

    spread = max(off_line_rad(m[inliers]), off_line_rad(n[inliers]))
    if spread < _LINE_SIGMAS * noise_rad:
        return NoPose("no_consistent_motion", evidence | {"off_line_rad": spread})

    plane = fit_plane(best, m[inliers], n[inliers], noise_rad)
    evidence |= {"on_plane": plane.on, "off_plane": plane.off}
    planar = _is_planar(problem, plane, best, int(inliers.sum()), gate_rad, noise_rad)
    if planar:
        # The plane's own two poses: with its constraint they are several times more accurate than epipolar lines alone,
        # and have the same residuals, so only the depths' signs tell them apart.
        order = np.argsort(problem.costs(np.array(plane.poses))[0], kind="stable")
        best, *modes = (plane.poses[k] for k in order)
        inliers = problem.explained(best, gate_rad)
        if inliers.sum() < _MIN_MATCHES:  # rays all around, half of them behind the plane's motion
            return NoPose("no_consistent_motion", evidence)
    else:
        # Off the plane, a rival must follow all matches, and must not be the same optimum on its way. One that as a raw
        # model misses half of the inliers is none: from noisy samples the best one itself missed a third at most.
        near = (report.costs[1:] - report.costs[0]) / threshold_rad**2 < 0.5 * inliers.sum()
        rivals = [*plane.poses[1:], *(problem.polish(model) for model in spread_out(report.models[1:][near], best))]
        modes = [_settle(problem, rival, noise_rad) for rival in rivals]
    alternatives = _alternatives(problem, modes, best, inliers, gate_rad, None if planar else noise_rad)
    first = _hypothesis(best, inliers)
    depths1, depths2 = depths_from_pose(first.R, first.t, m, n)
    cosine = np.einsum("ij,ij->i", m[inliers] @ first.R.T, n[inliers])
    return RelativePose(
        q_wxyz=first.q_wxyz,
        R=first.R,
        t=first.t,
        inliers=inliers,
        depths1=np.where(inliers, depths1, np.nan),
        depths2=np.where(inliers, depths2, np.nan),
        kind="planar" if planar else "general",
        alternatives=tuple(alternatives[: 1 if planar else 3]),
        noise_rad=noise_rad,
        parallax_rad=float(np.median(np.arccos(np.clip(cosine, -1, 1)))),
        parallax=parallax,
        covariance=_covariance(first, m, n, noise_rad),
        evidence=evidence,
    )


def _unit_bearings(bearings1: ArrayLike, bearings2: ArrayLike) -> tuple[Floats, Floats]:
    m, n = as_matches(bearings1, bearings2, at_least=0)
    if m.ndim != 2:
        raise InputError(f"bearings have shape {m.shape}: give two arrays (N, 3)")
    return m, n


def _ranking(scores: ArrayLike, count: int) -> Floats:
    ranking = as_floats(scores, "scores")
    if ranking.shape != (count,) or np.isnan(ranking).any():
        raise InputError(f"scores have shape {ranking.shape}: give a number for each of the {count} matches")
    return ranking


def _distinct(m: Floats, n: Floats) -> int:
    """How many matches differ: the same match twice is no second witness."""
    # Equal rows have equal projections; different ones agree on a generic axis as good as never.
    return len(np.unique(np.concatenate([m, n], axis=1) @ _GENERIC_AXIS))


def _is_planar(
    problem: RelativePoseProblem, plane: PlaneFit, best: Floats, inlying: int, gate_rad: float, noise_rad: float
) -> bool:
    """Whether the inliers of the best motion lie on one plane, and its motions follow them as well."""
    # A plane leaves no match over: the gate, 3 sqrt(2) deviations, passes all but one in 8000. Two in a hundred are
    # allowed for tails that are not Gaussian; 25 planes with 15 % outliers left 1.5 % at most. Little parallax passes
    # the gate as well, so what is left along the epipolar lines must look like noise, and the plane's motion must
    # follow them as well as the free one.
    return bool(
        len(plane.poses) == 2
        and not decides(plane.off, int(0.02 * inlying), inlying)
        and plane.along_rad < max(_FLAT, 1 + 6.6 / np.sqrt(plane.on)) * noise_rad
        and not all(_worse(problem, pose, best, gate_rad, noise_rad, *_PLANE_LEVEL) for pose in plane.poses)
    )


def _alternatives(
    problem: RelativePoseProblem,
    modes: list[Floats],
    best: Floats,
    inliers: Bools,
    gate_rad: float,
    noise_rad: float | None,
) -> list[Hypothesis]:
    """The modes that explain as much as the best motion, those of most inliers first.

    Residuals are compared where their noise is given: the two motions of a plane have the same.
    """
    alternatives: list[Hypothesis] = []
    where = directions_of(problem.m)
    for model in modes:
        explained = problem.explained(model, gate_rad)
        known = [best, *(np.concatenate([h.q_wxyz, h.t]) for h in alternatives)]
        if any(same_mode(model, other) for other in known):
            continue
        for_best, against = inliers & ~explained, explained & ~inliers
        # Regions of what either explains: a poster that fills a part of the view has as many as a wall.
        either = inliers | explained
        scatter = scatter_of_sum(for_best[either].astype(float) - against[either], where[either])
        if decides(int(for_best.sum()), int(against.sum()), int(inliers.sum()), scatter):
            continue
        if noise_rad is not None and _worse(problem, model, best, gate_rad, noise_rad, *_RIVAL_LEVEL):
            continue
        alternatives.append(_hypothesis(model, explained))
    return sorted(alternatives, key=lambda h: -int(h.inliers.sum()))


def _hypothesis(model: Floats, inliers: Bools) -> Hypothesis:
    q = canonical(model[:4])
    return Hypothesis(q, matrix_from_quaternion(q), model[4:], inliers)


def _covariance(hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float) -> Floats:
    inliers = hypothesis.inliers
    r, J = sampson_jacobian(hypothesis.R, hypothesis.t, m[inliers], n[inliers])
    # Of an M-estimate: mean psi^2 over the squared mean of its derivative, psi that of Geman and McClure.
    u = (r / (_GATE_SIGMAS * noise_rad)) ** 2
    spread = float(np.mean((r / (1 + u) ** 2) ** 2)) / max(float(np.mean((1 - 3 * u) / (1 + u) ** 3)), 0.1) ** 2
    return np.asarray(spread * np.linalg.pinv(J.T @ J, hermitian=True))


def _worse(
    problem: RelativePoseProblem,
    model: Floats,
    other: Floats,
    gate_rad: float,
    noise_rad: float,
    least: float,
    deviations: float,
) -> bool:
    """Whether a motion leaves larger residuals than another, by ``least`` noise variances and beyond their scatter.

    The scatter is that of the sum of differences (Vuong 1989), over matches or over regions of the view, so that no
    handful of matches with errors of their own decides.
    """
    r2, behind = problem.residuals(np.stack([model, other]))
    r2[behind] = np.inf
    difference = (np.minimum(r2[0], gate_rad**2) - np.minimum(r2[1], gate_rad**2)) / noise_rad**2
    told = difference != 0
    scatter = scatter_of_sum(difference[told], directions_of(problem.m[told]))
    return bool(difference.sum() > max(least, deviations * scatter))


def _settle(problem: RelativePoseProblem, model: Floats, noise_rad: float) -> Floats:
    """The optimum that a model belongs to, at a noise that is known."""
    for _ in range(2):
        use = problem.explained(model, problem.threshold_rad)
        if use.sum() < 6:
            break
        model = problem.refine(model, use, _GATE_SIGMAS * noise_rad)
    return model


def _tighten(problem: RelativePoseProblem, model: Floats) -> tuple[Floats, float]:
    """Refine with the noise that the residuals show in place of the caller's threshold; return both."""
    noise_rad = problem.threshold_rad / _GATE_SIGMAS
    before = np.zeros(len(problem), bool)
    for _ in range(3):
        r2, behind = problem.residuals(model[None])
        inlying = (r2[0] < problem.threshold_rad**2) & ~behind[0]
        inlying &= _typical(problem, model, inlying)
        # Where at most one match in a thousand changes sides, the noise does not change either.
        if inlying.sum() < 6 or (inlying ^ before).sum() <= 1e-3 * inlying.sum():
            break
        before = inlying
        # Median absolute deviation of a Gaussian; exact data keep a floor so that gates never close to nothing.
        noise_rad = max(1.4826 * float(np.sqrt(np.median(r2[0][inlying]))), 1e-3 * problem.threshold_rad)
        model = problem.refine(model, inlying, _GATE_SIGMAS * noise_rad)
    return model, noise_rad


def _typical(problem: RelativePoseProblem, model: Floats, inlying: Bools) -> Bools:
    """Where the depth of a match (N,) is one that the scene has.

    A wrong match that fits a motion by chance lies anywhere on its epipolar line; with little parallax the points of
    the scene share a few pixels of theirs.
    """
    typical = np.zeros(len(problem), bool)
    R, t = matrix_from_quaternion(model[:4]), model[4:]
    typical[inlying] = typical_ratios(R, t, problem.m[inlying], problem.n[inlying])
    return typical


def _rotation_or_nothing(
    R: Floats,
    rotation_r2: Floats,
    gate_rad: float,
    total: int,
    evidence: dict[str, float],
    parallax: ParallaxStatement | None = None,
) -> RelativePose | NoPose:
    # Two components per residual where the Sampson error has one: the same gate per component.
    inliers = rotation_r2 < 2 * gate_rad**2
    count = int(inliers.sum())
    evidence = evidence | {"rotation_inliers": count}
    # A rotation is fixed by two matches, and a random match agrees with it in two components: a chance agreement of
    # even a tenth of the matches does not happen, but an eighth may be one moving object: twice that is asked for.
    if count < max(_MIN_MATCHES, 0.25 * total):
        return NoPose("no_consistent_motion", evidence)
    nan = np.full(total, np.nan)
    noise_rad = float(np.sqrt(np.median(rotation_r2[inliers]) / (2 * np.log(2))))  # Rayleigh: median^2 = 2 ln 2 sigma^2
    return RelativePose(
        q_wxyz=quaternion_from_matrix(R),
        R=R,
        t=np.zeros(3),
        inliers=inliers,
        depths1=nan,
        depths2=nan.copy(),
        kind="rotation",
        alternatives=(),
        noise_rad=noise_rad,
        parallax_rad=0.0,
        parallax=parallax,
        covariance=np.full((5, 5), np.nan),
        evidence=evidence,
    )


def _chance_inliers(problem: RelativePoseProblem, model: Floats, gate_rad: float, rng: np.random.Generator) -> float:
    """How many matches the motion explains when the matches are shuffled, on average."""
    counts = []
    for _ in range(3):
        shuffled = CompiledPoseProblem(problem.m, problem.n[rng.permutation(len(problem))], problem.threshold_rad)
        counts.append(int(shuffled.explained(model, gate_rad).sum()))
    return float(np.mean(counts))
