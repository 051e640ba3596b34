r"""The poses of five matches, points on a plane included: all solutions of QuEst 5, by a polynomial of degree 10.

QuEst 5 (:mod:`quest.paper.quest5`) states that the normals ``R m x n`` of five epipolar planes are coplanar: all ten
determinants ``f_ijk(q)`` vanish [F18]_. They are quartics in q with 20 solutions, in ten twisted pairs. The two
rotations of a pair have the same t and the same matrix ``E = [t]x R`` up to its sign, and the coplanarity
``n . E m = 0`` is linear in E. So each pair is found once, as a matrix ``E = x E1 + y E2 + z E3 + E4`` in the null
space of the five equations that has the form [t]x R: nine cubics ``2 E E' E = tr(E E') E`` and ``det E = 0`` [N04]_.
Elimination of ten of the 20 monomials leaves ::

    C(z) (x, y, 1)' = 0

where the columns of the 3x3 matrix C have the degrees 3, 3 and 4 in z. Its determinant has the degree 10. Sturm's
chain counts the real roots in an interval, so that intervals are halved until each holds one. Of the four poses of an
E at most one has all five points in front of both cameras.

No rotation is a special case, and no start is needed: Newton's method on five matches found a quarter to a half of the
true poses in the same time.

References
----------
.. [F18] K. Fathian et al., "QuEst: A Quaternion-Based Approach for Camera Motion Estimation From Minimal Feature
   Points", IEEE Robotics and Automation Letters, 2018.
.. [N04] D. Nister, "An efficient solution to the five-point relative pose problem", PAMI 2004.
.. [H90] B. K. P. Horn, "Recovering baseline and orientation from essential matrix", 1990.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quest.algebra import orthonormalize, rotated
from quest.jit import compiled, inlined, part
from quest.robust.kernels.samples import Pool, enter_if_better
from quest.robust.kernels.scoring import rays_by_row

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Largest number of poses of a sample.
MOST_POSES = 10
#: Two matches are equal where a reflection finds this squared norm, as in the solver of six matches.
_DEPENDENT = 1e-24
#: The cubics depend on each other below this pivot: the matches obey a rotation without translation.
_PIVOT = 1e-13
#: Intervals are halved down to this width, relative to 1 + |z|; two roots in it are one.
_ROOT = 1e-10
#: Rotation of the basis E1 to E4, of no particular direction: a motion along an axis has zeros in E, and without a part
#: of E4 there is no z.
_W, _X, _Y, _Z = 0.7103520703773498, 0.38252034078307395, -0.29363885020383906, 0.5126932324975441
#: The products of two unknowns (x, y, z, 1): pairs a <= b.
_PAIRS = np.array([[0, 0], [0, 1], [0, 2], [0, 3], [1, 1], [1, 2], [1, 3], [2, 2], [2, 3], [3, 3]])
#: The order of the monomials, four letters each.
_MONOMIALS = "xxx yyy xxy xyy xxz xx1 yyz yy1 xyz xy1 xzz xz1 x11 yzz yz1 y11 zzz zz1 z11 111"
#: The products of a pair and an unknown as (pair, unknown, monomial), each monomial from all of its pairs.
_PRODUCTS = np.array(
    [
        [pair, unknown, _MONOMIALS.index("".join("xyz1"[k] for k in sorted((a, b, unknown)))) // 4]
        for pair, (a, b) in enumerate(_PAIRS.tolist())
        for unknown in range(4)
    ]
)


@part
def _essential_space(m: Floats, n: Floats, rows: Ints, A: Floats, E: Floats) -> bool:
    """Write four orthonormal matrices E (4, 9) with ``n . E m = 0``; false where there are more. A is scratch."""
    for i in range(5):
        at = rows[i]
        for j in range(3):
            for k in range(3):
                A[i, 3 * j + k] = n[at, j] * m[at, k]
    for k in range(5):
        norm2 = 0.0
        for j in range(k, 9):
            norm2 += A[k, j] * A[k, j]
        if not norm2 > _DEPENDENT:
            return False
        norm = -np.sqrt(norm2) if A[k, k] > 0 else np.sqrt(norm2)
        A[k, k] -= norm
        # -2 / |v|^2 of the reflection by v = A[k, k:].
        A[k, 9] = 1 / (norm * A[k, k])
        for i in range(k + 1, 5):
            dot = 0.0
            for j in range(k, 9):
                dot += A[i, j] * A[k, j]
            dot *= A[k, 9]
            for j in range(k, 9):
                A[i, j] += dot * A[k, j]
    # The reflections take the last four unit vectors to the null space.
    for i in range(4):
        for j in range(9):
            E[i, j] = 1.0 if j == 5 + i else 0.0
        for k in range(4, -1, -1):
            dot = 0.0
            for j in range(k, 9):
                dot += E[i, j] * A[k, j]
            dot *= A[k, 9]
            for j in range(k, 9):
                E[i, j] += dot * A[k, j]
    for j in range(9):
        a, b, c, d = E[0, j], E[1, j], E[2, j], E[3, j]
        E[0, j], E[1, j] = _W * a - _X * b - _Y * c - _Z * d, _X * a + _W * b - _Z * c + _Y * d
        E[2, j], E[3, j] = _Y * a + _Z * b + _W * c - _X * d, _Z * a - _Y * b + _X * c + _W * d
    return True


@inlined
def _of_rows(E: Floats, a: int, i: int, b: int, j: int) -> float:
    """The product of row i of the matrix E_a and row j of E_b."""
    i, j = 3 * i, 3 * j
    return float(E[a, i] * E[b, j] + E[a, i + 1] * E[b, j + 1] + E[a, i + 2] * E[b, j + 2])


@part
def _cubics(E: Floats, S: Floats, M: Floats) -> None:
    """Write the ten cubics as columns M (20, 10): monomial, equation; S (10, 12) is scratch."""
    for p in range(10):
        a, b = _PAIRS[p, 0], _PAIRS[p, 1]
        # E E' less half its trace, and the cross product of the last two rows of E: the parts of the unknowns a b.
        for i in range(3):
            for j in range(i, 3):
                value = _of_rows(E, a, i, b, j)
                if a != b:
                    value += _of_rows(E, b, i, a, j)
                S[p, 3 * i + j] = value
                S[p, 3 * j + i] = value
        half = 0.5 * (S[p, 0] + S[p, 4] + S[p, 8])
        S[p, 0] -= half
        S[p, 4] -= half
        S[p, 8] -= half
        for i in range(3):
            u, v = (i + 1) % 3, (i + 2) % 3
            value = E[a, 3 + u] * E[b, 6 + v] - E[a, 3 + v] * E[b, 6 + u]
            if a != b:
                value += E[b, 3 + u] * E[a, 6 + v] - E[b, 3 + v] * E[a, 6 + u]
            S[p, 9 + i] = value
    for k in range(20):
        for r in range(10):
            M[k, r] = 0.0
    for k in range(40):
        p, c, to = _PRODUCTS[k, 0], _PRODUCTS[k, 1], _PRODUCTS[k, 2]
        for i in range(3):
            for j in range(3):
                M[to, 3 * i + j] += (
                    S[p, 3 * i] * E[c, j] + S[p, 3 * i + 1] * E[c, 3 + j] + S[p, 3 * i + 2] * E[c, 6 + j]
                )
        M[to, 9] += S[p, 9] * E[c, 0] + S[p, 10] * E[c, 1] + S[p, 11] * E[c, 2]


@part
def _eliminate(M: Floats, row_of: Ints) -> bool:
    """Solve the ten cubics for their first ten monomials; ``row_of`` (10,) is the equation of each."""
    used = 0  # bit r: equation r is that of a monomial
    for k in range(10):
        p, largest = -1, _PIVOT
        for r in range(10):
            if abs(M[k, r]) > largest and not (used >> r) & 1:
                p, largest = r, abs(M[k, r])
        if p < 0:
            return False
        row_of[k] = p
        used |= 1 << p
        inverse = 1 / M[k, p]
        for c in range(k + 1, 20):
            factor = M[c, p] * inverse
            for r in range(10):
                M[c, r] -= factor * M[k, r]
            M[c, p] = factor
    return True


@part
def _matrix_in_z(M: Floats, row_of: Ints, C: Floats) -> None:
    """Write C (3, 3, 5): row (``xxz - z xx``, ``yyz - z yy``, ``xyz - z xy``), column (x, y, 1), power of z."""
    for row in range(3):
        e, f = row_of[4 + 2 * row], row_of[5 + 2 * row]
        for column in range(3):
            size, first = (3, 10 + 3 * column) if column < 2 else (4, 16)
            # The monomials of a column are ordered from the largest power of z to 1.
            for power in range(5):
                C[row, column, power] = 0.0
            for power in range(size):
                C[row, column, power] += M[first + size - 1 - power, e]
                C[row, column, power + 1] -= M[first + size - 1 - power, f]


@part
def _determinant(C: Floats, minors: Floats, powers: Floats) -> None:
    """Write the determinant of C, ``powers`` (11,), and the minors (3, 7) of its first two columns."""
    for k in range(11):
        powers[k] = 0.0
    for row in range(3):
        u, v = (row + 1) % 3, (row + 2) % 3
        for k in range(7):
            minors[row, k] = 0.0
        for i in range(4):
            for j in range(4):
                minors[row, i + j] += C[u, 0, i] * C[v, 1, j] - C[v, 0, i] * C[u, 1, j]
        for i in range(5):
            for j in range(7):
                powers[i + j] += C[row, 2, i] * minors[row, j]


@part
def _sturm_chain(powers: Floats, f: Floats, chain: Floats) -> bool:
    """Write Sturm's chain of a monic polynomial of degree 10 as quotients ``chain`` (10, 3); f (3, 11) is scratch.

    ``f_k = (a x + b) f_{k+1} - c f_{k+2}`` with rows (a, b, c), and each f_k has the leading coefficient 1 or -1.
    """
    for k in range(11):
        f[0, k] = powers[k]
    for k in range(10):
        f[1, k] = 0.1 * (k + 1) * powers[k + 1]
    first, second, third = 0, 1, 2
    for k in range(9):
        degree = 10 - k  # of f_k
        a = f[first, degree] * f[second, degree - 1]  # the leading coefficients are 1 or -1
        b = (f[first, degree - 1] - a * f[second, degree - 2]) * f[second, degree - 1]
        for j in range(degree - 1):
            f[third, j] = b * f[second, j] - f[first, j]
            if j > 0:
                f[third, j] += a * f[second, j - 1]
        c = abs(f[third, degree - 2])
        if not c > 1e-200:
            return False
        for j in range(degree - 1):
            f[third, j] /= c
        chain[k, 0], chain[k, 1], chain[k, 2] = a, b, c
        first, second, third = second, third, first
    chain[9, 0], chain[9, 1], chain[9, 2] = f[first, 1], f[first, 0], f[second, 0]
    return True


@part
def _changes(chain: Floats, x: float) -> int:
    """Number of changes of the sign along the chain at x."""
    after = chain[9, 2]
    value = chain[9, 0] * x + chain[9, 1]
    count = 1 if (after < 0) != (value < 0) else 0
    for k in range(8, -1, -1):
        before = (chain[k, 0] * x + chain[k, 1]) * value - chain[k, 2] * after
        if (before < 0) != (value < 0):
            count += 1
        after, value = value, before
    return count


@part
def _middle(low: float, high: float) -> float:
    """A number between two others; most roots are of the size of 1, the bound is mostly larger."""
    if low >= 0 and high > 4:
        return float(np.sqrt(max(low, 0.25) * high))
    if high <= 0 and low < -4:
        return -float(np.sqrt(max(-high, 0.25) * -low))
    return 0.5 * (low + high)


@part
def _root_between(powers: Floats, low: float, high: float) -> float:
    """The root of a monic polynomial of degree 10 in an interval that holds one, by Newton's method with bisection."""
    value = 1.0
    for k in range(9, -1, -1):
        value = value * low + powers[k]
    rising = value < 0
    x, step = _middle(low, high), high - low
    for _ in range(80):
        value, slope = 1.0, 0.0
        for k in range(9, -1, -1):
            slope = slope * x + value
            value = value * x + powers[k]
        if (value < 0) == rising:
            low = x
        else:
            high = x
        before = x
        # A step of Newton that leaves the interval, or is not half of the one before, gives way to a bisection.
        if abs(2 * value) > abs(step * slope) or not low < x - value / slope < high:
            x = _middle(low, high)
        else:
            x -= value / slope
        step = x - before
        # Newton's method doubles the digits, so the root is known to the last ones.
        if abs(step) <= 1e-8 * (1 + abs(x)):
            break
    return x


@part
def _real_roots(powers: Floats, f: Floats, chain: Floats, stack: Floats, roots: Floats) -> int:
    """Write the real roots of a polynomial of degree 10; returns their number. ``stack`` (64, 4) is scratch."""
    lead = powers[10]
    if not abs(lead) > 1e-200:
        return 0
    bound = 1.0  # all roots lie within 1 + the largest coefficient (Cauchy)
    for k in range(10):
        powers[k] /= lead
        bound = max(bound, 1 + abs(powers[k]))
    powers[10] = 1.0
    if not (bound < 1e100 and _sturm_chain(powers, f, chain)):
        return 0
    stack[0, 0], stack[0, 1] = -bound, bound
    stack[0, 2], stack[0, 3] = _changes(chain, -bound), _changes(chain, bound)
    depth, count = 1, 0
    while depth > 0:
        depth -= 1
        low, high, before, after = stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3]
        inside = before - after
        if inside < 0.5 or count == len(roots):
            continue
        middle = _middle(low, high)
        if inside < 1.5:
            roots[count] = _root_between(powers, low, high)
            count += 1
        elif high - low < _ROOT * (1 + abs(middle)) or depth + 2 > len(stack):
            roots[count] = middle
            count += 1
        else:
            changes = float(_changes(chain, middle))
            stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3] = low, middle, before, changes
            depth += 1
            stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3] = middle, high, changes, after
            depth += 1
    return count


@compiled
def _pose_of(E: Floats, m: Floats, n: Floats, rows: Ints, flat: float, R: Floats, t: Floats) -> bool:
    """Write the pose of an essential matrix (9,) that has all five points in front of both cameras [H90]_.

    The sign of a depth is left open where the squared sine of the parallax is at most ``flat``.
    """
    # t is orthogonal to the columns of E. The two most different columns have the longest product.
    largest, a0, a1, a2 = 0.0, 0.0, 0.0, 0.0
    for j in range(3):
        u, v = (j + 1) % 3, (j + 2) % 3
        x = E[3 + u] * E[6 + v] - E[6 + u] * E[3 + v]
        y = E[6 + u] * E[v] - E[u] * E[6 + v]
        z = E[u] * E[3 + v] - E[3 + u] * E[v]
        square = x * x + y * y + z * z
        if square > largest:
            largest, a0, a1, a2 = square, x, y, z
    if not largest > 0:
        return False
    norm2 = 0.0
    for j in range(9):
        norm2 += 0.5 * E[j] * E[j]
    scale = np.sqrt(norm2 / largest)
    a0, a1, a2 = a0 * scale, a1 * scale, a2 * scale  # of the norm of E's translation
    for side in range(2):
        # E = [b]x R gives (b . b) R = cof E - [b]x E, with b this vector or its opposite. The rows of the cofactors are
        # the products of the rows of E.
        sign = 1.0 - 2.0 * side
        for j in range(3):
            u, v = (j + 1) % 3, (j + 2) % 3
            e0, e1, e2 = E[j], E[3 + j], E[6 + j]
            R[0, j] = (E[3 + u] * E[6 + v] - E[3 + v] * E[6 + u] - sign * (a1 * e2 - a2 * e1)) / norm2
            R[1, j] = (E[6 + u] * E[v] - E[6 + v] * E[u] - sign * (a2 * e0 - a0 * e2)) / norm2
            R[2, j] = (E[u] * E[3 + v] - E[v] * E[3 + u] - sign * (a0 * e1 - a1 * e0)) / norm2
        t[0], t[1], t[2] = a0, a1, a2
        front = back = True
        for i in rows:
            n0, n1, n2 = n[i, 0], n[i, 1], n[i, 2]
            r0, r1, r2 = rotated(R, m, i)
            cosine = r0 * n0 + r1 * n1 + r2 * n2
            if 1 - cosine * cosine > flat:
                p, s = r0 * a0 + r1 * a1 + r2 * a2, n0 * a0 + n1 * a1 + n2 * a2
                front = front and cosine * s > p and s > cosine * p
                back = back and cosine * s < p and s < cosine * p
                if not (front or back):
                    break
        if front or back:
            orthonormalize(R)
            length = 1 / np.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
            if not front:
                length = -length
            t[0], t[1], t[2] = a0 * length, a1 * length, a2 * length
            return True
    return False


@compiled
def workspace() -> tuple[Floats, Floats, Floats, Floats, Ints, Floats, Floats]:
    """Arrays that :func:`solve_five` overwrites: one set for many samples."""
    return (
        np.empty((5, 10)),
        np.empty((5, 9)),
        np.empty((10, 12)),
        np.empty((20, 10)),
        np.empty(10, np.int64),
        np.empty((64, 4)),
        np.empty((32, 11)),
    )


@compiled
def solve_five(
    m: Floats,
    n: Floats,
    rows: Ints,
    flat: float,
    space: tuple[Floats, Floats, Floats, Floats, Ints, Floats, Floats],
    found_R: Floats,
    found_t: Floats,
) -> int:
    """Find all poses that five matches obey with the points in front of both cameras, whatever their rotation.

    The solutions are those of QuEst 5 [F18]_; the elimination is derived in the module docstring.

    Shapes: ``m, n`` (N, 3), ``rows`` (5,), ``found_R, found_t`` (10, 3, 3).

    * ``flat``: The sign of a depth is left open where the squared sine of the parallax is at most this value.
    * ``space``: See :func:`workspace`.
    * Returns: Number of poses. None where two matches are equal, or where the matches obey a rotation without
      translation.
    """
    A, E, S, M, row_of, stack, scratch = space
    C, minors, powers, f = scratch[:9].reshape(99)[:45].reshape(3, 3, 5), scratch[9:12], scratch[12], scratch[13:16]
    chain, roots = scratch[16:26], scratch[26]
    if not _essential_space(m, n, rows, A, E):
        return 0
    _cubics(E, S, M)
    if not _eliminate(M, row_of):
        return 0
    _matrix_in_z(M, row_of, C)
    _determinant(C, minors, powers)
    count = 0
    for s in range(_real_roots(powers, f, chain, stack, roots)):
        z = roots[s]
        for row in range(3):
            for column in range(3):
                value = C[row, column, 4]
                for k in range(3, -1, -1):
                    value = value * z + C[row, column, k]
                f[row, column] = value
        largest, x, y, w = 0.0, 0.0, 0.0, 0.0
        for row in range(3):
            u, v = (row + 1) % 3, (row + 2) % 3
            c0 = f[u, 1] * f[v, 2] - f[u, 2] * f[v, 1]
            c1 = f[u, 2] * f[v, 0] - f[u, 0] * f[v, 2]
            c2 = f[u, 0] * f[v, 1] - f[u, 1] * f[v, 0]
            if c0 * c0 + c1 * c1 + c2 * c2 > largest:
                largest, x, y, w = c0 * c0 + c1 * c1 + c2 * c2, c0, c1, c2
        if not largest > 0:
            continue
        norm = 1 / np.sqrt(x * x + y * y + w * w * (1 + z * z))
        x, y, w = x * norm, y * norm, w * norm
        for j in range(9):
            E[4, j] = x * E[0, j] + y * E[1, j] + w * z * E[2, j] + w * E[3, j]
        if _pose_of(E[4], m, n, rows, flat, found_R[count], found_t[count]):
            count += 1
    return count


@compiled
def try_samples_of_five(m: Floats, n: Floats, samples: Ints, threshold_rad: float, pool: Pool) -> None:
    """Solve samples of five matches, score the poses, and keep the best of each mode in the pool.

    Shapes: ``m, n`` (N, 3), ``samples`` (S, 5).

    * ``m, n``: Unit bearings, in random order: a bad model is recognized by the first matches.
    """
    rays, space = rays_by_row(m, n), workspace()
    found_R, found_t = np.empty((MOST_POSES, 3, 3)), np.empty((MOST_POSES, 3))
    for i in range(len(samples)):
        for k in range(solve_five(m, n, samples[i], 2 * threshold_rad * threshold_rad, space, found_R, found_t)):
            enter_if_better(rays, found_R[k], found_t[k], threshold_rad, pool)
