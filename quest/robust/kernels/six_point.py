r"""The poses of six matches, points on a plane included: the solutions of QuEst 6 by an action matrix of size 6.

QuEst 6 (:mod:`quest.solvers.quest6`) states that the normals ``R m x n`` of six epipolar planes are coplanar: some t is
orthogonal to all of them. [F17]_ eliminates t. Quartics in q remain, with 2 solutions for general points and 12 for
points on a plane (:mod:`quest.solvers.quest6_fast`), and the eigenproblem in q has the size 20, deflated 12. The
solutions come in pairs, the twisted pairs: the two rotations of a pair have the same t and the same matrix
``E = [t]x R`` up to its sign. The orthogonality ``n . E m = 0`` is linear in E. So the condition of QuEst 6 is stated
in E here. Each pair counts once, and the size of the eigenproblem is 6. The elimination is that of QuEst 6:

Six matches leave ``E = a E1 + b E2 + c E3``. The nine equations ``2 E E' E = tr(E E') E`` of essential matrices are
cubics in a, b and c. With x1 the six monomials that contain a and x2 the four other ones ::

    A1 x1 + A2 x2 = 0      so      x2 = B x1,      B = -pinv(A2) A1

A2 has rank 4 for general points and for points on a plane, so the two need no distinction. Multiplication of x1 by
``lambda = b / a`` turns its entries into other monomials. This is the eigenproblem of size 6. Three of its rows only
move entries, so with ``x1 = a^3 (1, lambda, mu, lambda^2, lambda mu, mu^2)`` it reads ::

    P(lambda) (1, mu, mu^2)' = 0

where the columns of the 3x3 matrix P have the degrees 3, 2 and 1 in lambda. The eigenvalues are the roots of ``det P``,
of degree 6, and mu follows from the null vector. No rotation is a special case, and no start is needed.

Under noise two real roots may become complex. Their real part is a candidate, as in the other solvers of QuEst: here a
place where ``|det P|`` has a minimum. All candidates are refined on the
Sampson errors of the sample. Six equations determine five unknowns, so no pose fits most samples with outliers, and
these samples need no scoring.

What was tried (36 scenes of ``tests/benchmarks/quest/scenes.py`` with 0.7 px; share of the samples without outliers
from which refinement on all matches finds the motion)

* The candidates as they are 0.49, refined by one step 0.60, by two steps 0.62, by five steps 0.65. With the bounds on
  the residuals below, which save a quarter of the time, four steps have 0.61.
* Real roots alone, without the minima of ``|det P|``: 0.56 in place of 0.61.
* Newton's method on five of the six matches from two starts, :func:`quest.robust.kernels.newton_five`: 0.40.

References
----------
.. [F17] K. Fathian et al., "Quaternion Based Camera Pose Estimation From Matched Feature Points", 2017.
.. [H90] B. K. P. Horn, "Recovering baseline and orientation from essential matrix", 1990.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.robust.kernels.compiler import compiled
from quest.robust.kernels.refinement import refine
from quest.robust.kernels.samples import Pool, enter_if_better, mode_distance
from quest.robust.kernels.scoring import rays_by_row
from quest.robust.kernels.small_algebra import copy_pose, orthonormalize

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Largest number of poses of a sample, one for each solution.
MOST_POSES = 6
#: Number of steps that refine a candidate on its sample, see the module docstring.
STEPS = 4
#: A candidate is refined where its root mean square residual, times the root of six, is below this multiple of the
#: threshold. Noise takes the solutions of the cubics that far from their refined pose: with 10 in place of 50 a sixth
#: of the yield is lost, without a bound the time of a sample with outliers rises by a quarter.
_NEAR = 50.0
#: A refined pose explains the sample where the same measure is below this multiple of the threshold. Its residuals have
#: one degree of freedom, so it is 4.5 standard deviations of the noise.
_EXPLAINED = 1.5
#: Number of matches of a true pose whose depths may be negative: noise decides the sign of a depth of a distant point.
_MOST_BEHIND = 1
#: Two refined poses that are nearer than this (radians, rotation plus direction) are one.
_SAME_POSE_RAD = 0.01
#: The roots are refined afterwards, so they need half of the digits only.
_ROOT = 1e-9
#: A column depends on the others where elimination leaves this squared norm: two matches are equal, or there is no
#: translation. Rounding leaves 1e-31.
_DEPENDENT = 1e-24
#: Position of the product of two of (a, b, c) among aa, ab, ac, bb, bc, cc.
_QUADRATIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
#: Position of such a product times a, b or c among x2 = (ccc, bbb, bbc, bcc), x1 = (aaa, aab, aac, abb, abc, acc).
_CUBIC = np.array([[4, 5, 6], [5, 7, 8], [6, 8, 9], [7, 1, 2], [8, 2, 3], [9, 3, 0]])
#: Powers of mu and of lambda in each entry of x1 / a^3.
_POWER_OF_MU, _POWER_OF_LAMBDA = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 0, 2, 1, 0])
#: Rotation of the basis E1, E2, E3, of no particular direction: motions along an axis have zeros in E, and a = 0 has no
#: lambda.
_AXES = np.array([[2.0, -3.0, 6.0], [6.0, -2.0, -3.0], [3.0, 6.0, 2.0]]) / 7


@compiled
def _triangularize(columns: Floats, count: int) -> bool:
    """Make the first columns of a matrix upper triangular by reflections of all; false where they are dependent.

    Each row of the array is a column of the matrix. ``count`` must be no constant: numba would compile a version of
    this function for each constant.
    """
    size = columns.shape[1]
    for k in range(count):
        norm2 = 0.0
        for r in range(k, size):
            norm2 += columns[k, r] * columns[k, r]
        if not norm2 > _DEPENDENT:
            return False
        norm = -np.sqrt(norm2) if columns[k, k] > 0 else np.sqrt(norm2)
        columns[k, k] -= norm
        for c in range(k + 1, len(columns)):
            dot = 0.0
            for r in range(k, size):
                dot += columns[c, r] * columns[k, r]
            dot /= norm * columns[k, k]
            for r in range(k, size):
                columns[c, r] += dot * columns[k, r]
        columns[k, k] = norm
    return True


@compiled
def _essential_space(m: Floats, n: Floats, E: Floats) -> bool:
    """Write three orthonormal matrices E (3, 3, 3) with ``n . E m = 0``; false where there are more than three."""
    # The reflections that triangularize the matches turn three unit vectors into the basis. The rows from 6 on become
    # the reflections themselves.
    columns = np.empty((15, 9))
    for j in range(9):
        for i in range(9):
            columns[6 + i, j] = 0.0
        columns[6 + j, j] = 1.0
        for i in range(6):
            columns[i, j] = n[i, j // 3] * m[i, j % 3]
    if not _triangularize(columns, len(m)):
        return False
    for k in range(3):
        for j in range(9):
            E[k, j // 3, j % 3] = (
                _AXES[k, 0] * columns[6 + j, 6] + _AXES[k, 1] * columns[6 + j, 7] + _AXES[k, 2] * columns[6 + j, 8]
            )
    return True


@compiled
def _action(E: Floats, P: Floats) -> bool:
    """Write the coefficients P (3, 3, 4): power of mu, row, power of lambda; false where the cubics are dependent."""
    products, cubics, B = np.empty((6, 3, 3)), np.empty((10, 9)), np.empty(4)
    for i in range(3):
        for j in range(3):
            for p in range(6):
                products[p, i, j] = 0.0
            for p in range(10):
                cubics[p, 3 * i + j] = 0.0
            for p in range(4):
                P[i, j, p] = 0.0
    # E E' and then (E E' - tr(E E') / 2) E, as polynomials in a, b, c.
    for k in range(3):
        for p in range(3):
            for i in range(3):
                for j in range(3):
                    for r in range(3):
                        products[_QUADRATIC[k, p], i, j] += E[k, i, r] * E[p, j, r]
    for p in range(6):
        half = 0.5 * (products[p, 0, 0] + products[p, 1, 1] + products[p, 2, 2])
        for i in range(3):
            products[p, i, i] -= half
        for k in range(3):
            for i in range(3):
                for j in range(3):
                    for r in range(3):
                        cubics[_CUBIC[p, k], 3 * i + j] += products[p, i, r] * E[k, r, j]
    if not _triangularize(cubics, len(B)):
        return False
    for d in range(6):
        for k in range(3, 0, -1):  # the row of ccc is not needed
            B[k] = -cubics[4 + d, k]
            for j in range(k + 1, 4):
                B[k] -= cubics[j, k] * B[j]
            B[k] /= cubics[k, k]
            P[_POWER_OF_MU[d], k - 1, _POWER_OF_LAMBDA[d]] = B[k]
    # lambda times abb, abc and acc are bbb, bbc and bcc.
    P[0, 0, 3] = P[1, 1, 2] = P[2, 2, 1] = -1.0
    return True


@compiled
def _value(powers: Floats, degree: int, x: float) -> tuple[float, float]:
    """Value and slope of a polynomial at x."""
    value, slope = powers[degree], 0.0
    for k in range(degree - 1, -1, -1):
        slope = slope * x + value
        value = value * x + powers[k]
    return value, slope


@compiled
def _roots_inside(powers: Floats, roots: Floats) -> int:
    """Write the real roots of degree 6 in [-1, 1], then the minima of the absolute value; returns their number."""
    derivatives, ends = np.empty((7, 7)), np.empty(8)
    for i in range(7):
        derivatives[6, i] = powers[i]
    for d in range(5, 0, -1):
        for i in range(d + 1):
            derivatives[d, i] = (i + 1) * derivatives[d + 1, i + 1]
    # Between two roots of its derivative a polynomial has at most one root.
    ends[0], known, count = -1.0, 0, 0
    for d in range(1, 7):
        known, count = count, 0
        for i in range(known):
            ends[i + 1] = roots[i]
        ends[known + 1] = 1.0
        rising = _value(derivatives[d], d, ends[0])[0] < 0
        for i in range(known + 1):
            low, high = ends[i], ends[i + 1]
            if (_value(derivatives[d], d, high)[0] < 0) == rising:
                continue
            before, x = low, 0.5 * (low + high)
            while abs(x - before) > _ROOT:
                value, slope = _value(derivatives[d], d, x)
                if (value < 0) == rising:
                    low = x
                else:
                    high = x
                before, x = x, x - value / slope
                # The root lies between the ends, so the middle replaces a step of Newton that leaves them.
                if not low < x < high:
                    x = 0.5 * (low + high)
            roots[count] = x
            count += 1
            rising = not rising
    for i in range(1, known + 1):
        value, _ = _value(powers, d, ends[i])
        _, curvature = _value(derivatives[d - 1], d - 1, ends[i])
        if value * curvature > 0:
            roots[count] = ends[i]
            count += 1
    return count


@compiled
def _solutions(P: Floats, ratios: Floats) -> int:
    """Write (a, b, c) of all solutions into the rows of ratios (24, 3); returns their number."""
    powers, roots, N = np.empty((2, 7)), np.empty(12), np.empty((3, 3))
    for i in range(7):
        powers[0, i] = 0.0
    for r in range(3):
        for swap in range(2):
            u, v, sign = (r + 1 + swap) % 3, (r + 2 - swap) % 3, 1.0 - 2.0 * swap
            for i in range(4):
                for j in range(3):
                    for k in range(2):
                        powers[0, i + j + k] += sign * P[0, r, i] * P[1, u, j] * P[2, v, k]
    for i in range(7):
        powers[1, i] = powers[0, 6 - i]
    total = 0
    # The reversed polynomial has the inverse roots: a / b is small where b / a is large.
    for side in range(2):
        for s in range(_roots_inside(powers[side], roots)):
            a, b = 1.0, roots[s]
            if side == 1:
                a, b = b, a
            for column in range(3):
                for r in range(3):
                    value, power_of_a = 0.0, 1.0
                    for i in range(3 - column, -1, -1):
                        value = value * b + power_of_a * P[column, r, i]
                        power_of_a *= a
                    N[r, column] = value
            largest, c = -1.0, 0.0
            for r in range(3):
                u, v = (r + 1) % 3, (r + 2) % 3
                x = N[u, 1] * N[v, 2] - N[u, 2] * N[v, 1]
                y = N[u, 2] * N[v, 0] - N[u, 0] * N[v, 2]
                z = N[u, 0] * N[v, 1] - N[u, 1] * N[v, 0]
                if x * x + y * y + z * z > largest:
                    largest = x * x + y * y + z * z
                    c = y / x if abs(x) > abs(z) else z / y
            ratios[total, 0], ratios[total, 1], ratios[total, 2] = a, b, c
            total += 1
    return total


@compiled
def _pose_of(E: Floats, m: Floats, n: Floats, R: Floats, t: Floats) -> float:
    """Write the pose of an essential matrix [H90]_ and return the sum of its squared Sampson errors.

    Of the four poses that with most points in front of both cameras is written. The sum is infinite where more than
    ``_MOST_BEHIND`` points are behind a camera.
    """
    cofactors, candidate, axis = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    largest, norm2 = 0.0, 0.0
    for j in range(3):
        u, v, square = (j + 1) % 3, (j + 2) % 3, 0.0
        for i in range(3):
            w, x = (i + 1) % 3, (i + 2) % 3
            cofactors[i, j] = E[w, u] * E[x, v] - E[w, v] * E[x, u]
            square += cofactors[i, j] * cofactors[i, j]
            norm2 += 0.5 * E[i, j] * E[i, j]
        # t is orthogonal to the columns of E. The two most different columns have the longest product.
        if square > largest:
            largest = square
            for i in range(3):
                axis[i] = cofactors[i, j] / np.sqrt(square)
    norm, best, fewest = np.sqrt(norm2), np.inf, _MOST_BEHIND + 1
    if not largest > 0:
        return best
    for _ in range(2):
        # E = [b]x R gives (b . b) R = cof E - [b]x E, with b = norm axis or its opposite.
        for i in range(3):
            u, v = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                candidate[i, j] = cofactors[i, j] - norm * (axis[u] * E[v, j] - axis[v] * E[u, j])
        orthonormalize(candidate)
        norm = -norm
        squares, behind, behind_opposite = _residuals(m, n, candidate, axis)
        if min(behind, behind_opposite) < fewest:
            best, fewest = squares, min(behind, behind_opposite)
            copy_pose(candidate, axis, R, t)
            if behind_opposite < behind:
                for i in range(3):
                    t[i] = -axis[i]
    return best


@compiled
def _residuals(m: Floats, n: Floats, R: Floats, t: Floats) -> tuple[float, int, int]:
    """Sum of squared Sampson errors, and numbers of matches behind a camera with t and with -t."""
    squares, behind, behind_opposite = 0.0, 0, 0
    for i in range(len(m)):
        a0 = R[0, 0] * m[i, 0] + R[0, 1] * m[i, 1] + R[0, 2] * m[i, 2]
        a1 = R[1, 0] * m[i, 0] + R[1, 1] * m[i, 1] + R[1, 2] * m[i, 2]
        a2 = R[2, 0] * m[i, 0] + R[2, 1] * m[i, 1] + R[2, 2] * m[i, 2]
        p, s = a0 * t[0] + a1 * t[1] + a2 * t[2], n[i, 0] * t[0] + n[i, 1] * t[1] + n[i, 2] * t[2]
        cosine = a0 * n[i, 0] + a1 * n[i, 1] + a2 * n[i, 2]
        e = (a1 * n[i, 2] - a2 * n[i, 1]) * t[0] + (a2 * n[i, 0] - a0 * n[i, 2]) * t[1]
        e += (a0 * n[i, 1] - a1 * n[i, 0]) * t[2]
        squares += e * e / max(2 - p * p - s * s - 2 * e * e, 1e-12)
        # Signs of the depths, see quest.geometry.epipolar.depths_from_pose; -t has the opposite signs.
        behind += cosine * s < p or s < cosine * p
        behind_opposite += cosine * s > p or s > cosine * p
    return squares, behind, behind_opposite


@compiled
def solve_six(
    m: Floats, n: Floats, rows: Ints, threshold_rad: float, iterations: int, found_R: Floats, found_t: Floats
) -> int:
    """Find the poses that explain six matches, whatever their rotation.

    The solutions are those of QuEst 6 [F17]_; the elimination is derived in the module docstring.

    Shapes: ``m, n`` (N, 3), ``rows`` (6,), ``found_R, found_t`` (6, 3, 3).

    * ``threshold_rad``: Sampson error above which a match is an outlier. Poses with residuals beyond it are not
      returned.
    * ``iterations``: Number of steps that refine a pose on the sample, :data:`STEPS` in the search.
    * Returns: Number of poses: for general points one or two, for points on a plane mostly two. None where two matches
      are equal, or where the matches obey a rotation without translation.
    """
    E, P, ratios, squares = np.empty((3, 3, 3)), np.empty((3, 3, 4)), np.empty((24, 3)), np.empty(6)
    m6, n6, use = np.empty((6, 3)), np.empty((6, 3)), np.empty(6, np.bool_)
    sum_E, R, t = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for i in range(6):
        use[i] = True
        for j in range(3):
            m6[i, j], n6[i, j] = m[rows[i], j], n[rows[i], j]
    if not (_essential_space(m6, n6, E) and _action(E, P)):
        return 0
    limit, count = threshold_rad * threshold_rad, 0
    for s in range(_solutions(P, ratios)):
        for i in range(3):
            for j in range(3):
                sum_E[i, j] = ratios[s, 0] * E[0, i, j] + ratios[s, 1] * E[1, i, j] + ratios[s, 2] * E[2, i, j]
        if not _pose_of(sum_E, m6, n6, R, t) < _NEAR * _NEAR * limit:
            continue
        refine(m6, n6, use, R, t, 1.0, iterations)  # a kernel of one radian is least squares
        total, _, _ = _residuals(m6, n6, R, t)
        if not total < _EXPLAINED * _EXPLAINED * limit:
            continue
        at = 0
        while at < count and mode_distance(R, t, found_R[at], found_t[at]) > _SAME_POSE_RAD:
            at += 1
        if at == len(squares) or (at < count and squares[at] <= total):
            continue
        copy_pose(R, t, found_R[at], found_t[at])
        squares[at], count = total, max(count, at + 1)
    return count


@compiled
def try_samples_of_six(m: Floats, n: Floats, samples: Ints, threshold_rad: float, pool: Pool) -> None:
    """Solve samples of six matches, score the poses, and keep the best of each mode in the pool.

    Shapes: ``m, n`` (N, 3), ``samples`` (S, 6).

    * ``m, n``: Unit bearings, in random order: a bad model is recognized by the first matches.
    """
    rays, found_R, found_t = rays_by_row(m, n), np.empty((MOST_POSES, 3, 3)), np.empty((MOST_POSES, 3))
    for i in range(len(samples)):
        for k in range(solve_six(m, n, samples[i], threshold_rad, STEPS, found_R, found_t)):
            enter_if_better(rays, found_R[k], found_t[k], threshold_rad, pool)
