"""The last refinement of a motion, with a scale for each match, and the likelihood by which motions are compared.

A match that lies within the threshold is one of three: exact to a deviation s, exact to 3 s, or an outlier, whose
residual is uniform within the threshold. The shares of the three are those of its group. The groups are the distances
from the typical depth: an outlier lies anywhere on its epipolar line, so that far from the typical depth more of the
matches are outliers. Shuffled matches tell how many to expect there. Maximum likelihood finds s, the shares and the
motion together, by expectation and maximization.

Two motions have different scales, and the one with fewer and better matches may have the larger likelihood. So motions
are compared by the likelihood without a scale: each match has its own, and all scales from a hundredth of the threshold
to a third of it are equally probable in their logarithm.

References
----------
.. [D77] A. P. Dempster, N. M. Laird, D. B. Rubin, "Maximum likelihood from incomplete data via the EM algorithm", 1977.
.. [B20] D. Barath et al., "MAGSAC++, a fast, reliable and accurate robust estimator", CVPR 2020: no scale is known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.robust.kernels.compiler import compiled
from quest.robust.kernels.noise import distance_from_typical, distances_from_typical, ratio_of_depth, typical_noise
from quest.robust.kernels.refinement import damped_step, derivatives, move, sums_of
from quest.robust.kernels.scoring import match_residual
from quest.robust.kernels.small_algebra import copy_pose, median_in_place, model_of_pose, rotation_of_model

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Fewer matches do not determine a motion: it has five unknowns.
_LEAST = 6
#: Distances from the typical depth that bound the groups, in median absolute deviations; each is twice the one before.
_BOUNDS = np.array([3.0, 6.0, 12.0])
#: Shares of the matches of deviation s, of those of deviation 3 s, and of outliers, that a group without a match has.
#: They weigh as much as one match, and the outliers that chance explains in the group are added to the third.
_PRIOR = np.array([0.5, 0.25, 0.25])
#: Least number of shuffled matches: where chance explains one in a hundred, their number is known to 40 %.
_SHUFFLED = 600
#: The motion has adapted to the exact matches by its unknowns. With one more match of a third of the threshold, s does
#: not fall to zero where a motion fits few matches exactly.
_UNKNOWNS = 5
#: The deviation of the less exact matches, in s. One exponential gives both densities: the ninth power is the other.
_WIDE = 3.0
#: A round selects the matches and their groups, until these stay the same. Steps of a round; updates of s and of the
#: shares before the first.
_ROUNDS, _STEPS, _UPDATES = 3, 6, 3
#: A round ends where a step would move the motion by less than a hundredth of its standard deviation.
_SETTLED = 1e-4


@compiled
def refine_with_noise(
    m: Floats, n: Floats, model: Floats, mixture: bool, threshold_rad: float, least_rad: float, mads: float,
    least_sine2: float,
) -> tuple[Floats, int, float]:  # fmt: skip
    """Refine a pose in a row by maximum likelihood, or leave it as it is, and measure its noise.

    Shapes: ``m, n`` (N, 3), ``model`` (7,), returns ``model`` (7,).

    * Returns: The pose, and its number and median of :func:`quest.robust.kernels.noise.typical_noise`.
    """
    R, t = rotation_of_model(model), model[4:].copy()
    if mixture:
        refine_mixture(m, n, R, t, threshold_rad, least_rad, least_sine2)
    count, median_rad = typical_noise(m, n, R, t, threshold_rad, mads, least_sine2)
    return model_of_pose(R, t), count, median_rad


@compiled
def refine_mixture(
    m: Floats, n: Floats, R: Floats, t: Floats, threshold_rad: float, least_rad: float, least_sine2: float
) -> tuple[Floats, float]:
    """Refine a pose in place by maximum likelihood, see the module docstring.

    Shapes: ``m, n`` (N, 3), ``R, t`` (3, 3), returns ``shares`` (4, 3).

    * ``least_rad``: Smallest s.
    * Returns: The shares of each group, and s.
    """
    total, limit = len(m), threshold_rad * threshold_rad
    use, values, group_before = np.empty(total, np.bool_), np.empty(total), np.full(total, -1)
    settled = False
    shares, prior, s = np.empty((len(_BOUNDS) + 1, 3)), np.empty((len(_BOUNDS) + 1, 3)), threshold_rad / 3
    for g in range(len(shares)):
        for k in range(3):
            shares[g, k] = prior[g, k] = _PRIOR[k]
    for turn_number in range(_ROUNDS):
        count = typical = 0
        for i in range(total):
            r2, behind = match_residual(m, i, n, i, R, t, 2 * limit)
            use[i] = r2 < limit and not behind
            values[i] = r2
            count += use[i]
        if count < _LEAST:
            break
        distances, middle, spread = distances_from_typical(m, n, R, t, least_sine2, use)
        if turn_number == 0:
            _add_chance(m, n, R, t, limit, least_sine2, middle, spread, total - count, prior)
        if turn_number == 0:
            # An outlier far from the typical depth has a long lever: a pose of the search may be fitted to it, and then
            # it seems to be exact. So the first round leaves out what is untypical.
            count = 0
            for i in range(total):
                use[i] = distances[i] <= _BOUNDS[1]
                count += use[i]
        rays, group, at, changed = np.empty((6, count)), np.empty(count, np.int64), 0, False
        for i in range(total):
            group_now = _group_of(distances[i]) if use[i] else -1
            changed |= group_now != group_before[i]
            group_before[i] = group_now
            if not use[i]:
                continue
            for k in range(3):
                rays[k, at], rays[3 + k, at] = m[i, k], n[i, k]
            group[at] = group_now
            at += 1
            if distances[i] <= _BOUNDS[1]:
                values[typical] = values[i]
                typical += 1
        if settled and not changed:
            break
        if turn_number == 0 and typical > 0:
            s = 1.4826 * np.sqrt(median_in_place(values[:typical]))
        s, settled = _maximize(
            rays, group, R, t, threshold_rad, least_rad, prior, shares, s, _UPDATES if turn_number == 0 else 1
        )
    return shares, s


@compiled
def _group_of(distance: float) -> int:
    """The group of a distance from the typical depth; ``np.searchsorted`` would load scipy with numba."""
    group = 0
    while group < len(_BOUNDS) and _BOUNDS[group] < distance:
        group += 1
    return group


@compiled
def _add_chance(
    m: Floats, n: Floats, R: Floats, t: Floats, limit: float, least_sine2: float, middle: float, spread: float,
    outliers: int, prior: Floats,
) -> None:  # fmt: skip
    """Add the number of outliers that the pose explains by chance in each group, from shuffled matches."""
    total = len(m)
    rounds = max(2, -(-_SHUFFLED // total))
    for k in range(rounds):
        # Matches often come sorted by their place, so that neighbours in the list are no random partners.
        offset = max(1, (k + 1) * total // (rounds + 1))
        for i in range(total):
            j = (i + offset) % total
            r2, behind = match_residual(m, i, n, j, R, t, 2 * limit)
            if r2 < limit and not behind:
                ratio = ratio_of_depth(m, i, n, j, R, t, least_sine2)
                group = _group_of(distance_from_typical(ratio, middle, spread))
                prior[group, 2] += outliers / (rounds * total)


@compiled
def _maximize(
    rays: Floats, group: Ints, R: Floats, t: Floats, threshold_rad: float, least_rad: float, prior: Floats,
    shares: Floats, s: float, updates: int,
) -> tuple[float, bool]:  # fmt: skip
    """Maximize the likelihood over the pose, the shares and s, for given matches and groups.

    * Returns: s, and whether the pose is at the maximum.
    """
    count = rays.shape[1]
    rows, rows_new, weights = np.empty((7, count)), np.empty((7, count)), np.empty(count)
    A, g, damped, step = np.empty((5, 5)), np.empty(5), np.empty((5, 5)), np.empty(5)
    R_new, t_new, damping = np.empty((3, 3)), np.empty(3), 1e-4
    derivatives(rays, R, t, 1.0, rows)
    for _ in range(updates):
        s = _expect(rows, group, threshold_rad, least_rad, prior, shares, s, weights)
    cost = _weigh(rows, weights)
    sums_of(rows, A, g)
    for _ in range(_STEPS):
        if not damped_step(A, g, damping, damped, step):
            break
        gain = 0.0
        for j in range(5):
            gain -= g[j] * step[j]
        if gain < _SETTLED * s * s:
            return s, True
        move(R, t, step, R_new, t_new)
        derivatives(rays, R_new, t_new, 1.0, rows_new)
        if _weigh(rows_new, weights) <= cost:
            copy_pose(R_new, t_new, R, t)
            rows, rows_new = rows_new, rows
            damping = max(0.1 * damping, 1e-9)
            s = _expect(rows, group, threshold_rad, least_rad, prior, shares, s, weights)
            cost = _weigh(rows, weights)
            sums_of(rows, A, g)
        else:
            damping *= 10
            if damping > 1e4:
                break
    return s, False


@compiled
def _weigh(rows: Floats, weights: Floats) -> float:
    """Write the roots of the weights into the rows of derivatives; return the weighted sum of squares."""
    cost = 0.0
    for i in range(len(weights)):
        rows[6, i] = np.sqrt(weights[i])
        cost += weights[i] * rows[5, i] * rows[5, i]
    return cost


@compiled
def _expect(
    rows: Floats, group: Ints, threshold_rad: float, least_rad: float, prior: Floats, shares: Floats, s: float,
    weights: Floats,
) -> float:  # fmt: skip
    """Update the shares in place, the weights of the matches, and s, which is returned."""
    sums = prior.copy()
    squares = normal = 0.0
    # The density at zero of |r|, r normal, is sqrt(2 / pi) / s.
    at_zero, by_wide = 0.7978845608028654 / s, 1 / (_WIDE * _WIDE)
    for i in range(len(weights)):
        k, r2 = group[i], rows[5, i] * rows[5, i]
        wide = np.exp(-0.5 * by_wide * r2 / (s * s))
        square = wide * wide
        fourth = square * square
        exact = shares[k, 0] * at_zero * fourth * fourth * wide
        wide *= shares[k, 1] * at_zero / _WIDE
        outlier = shares[k, 2] / threshold_rad
        both = exact + wide + outlier
        exact, wide, outlier = exact / both, wide / both, outlier / both
        sums[k, 0], sums[k, 1], sums[k, 2] = sums[k, 0] + exact, sums[k, 1] + wide, sums[k, 2] + outlier
        weights[i] = exact + wide * by_wide
        squares += weights[i] * r2
        normal += exact + wide
    for k in range(len(shares)):
        total = sums[k, 0] + sums[k, 1] + sums[k, 2]
        for j in range(3):
            shares[k, j] = sums[k, j] / total
    squares += threshold_rad * threshold_rad / 9
    s = np.sqrt(squares / max(normal - _UNKNOWNS + 1, 1.0))
    return min(max(s, least_rad), 0.5 * threshold_rad)


@compiled
def log_likelihood(m: Floats, n: Floats, model: Floats, threshold_rad: float, table: Floats) -> float:
    """Logarithm of the likelihood of a pose without a scale, less that of outliers alone.

    Shapes: ``m, n`` (N, 3), ``model`` (7,), ``table`` (K,).

    * ``table``: Logarithm of the likelihood of a match, less that of an outlier, for residuals from zero to the
      threshold in equal steps.
    """
    R, t = rotation_of_model(model), model[4:]
    limit, last, total = threshold_rad * threshold_rad, len(table) - 1, 0.0
    for i in range(len(m)):
        r2, behind = match_residual(m, i, n, i, R, t, 2 * limit)
        if r2 < limit and not behind:
            place = np.sqrt(r2 / limit) * last
            at = int(place)
            total += table[at] + (place - at) * (table[min(at + 1, last)] - table[at])
    return total
