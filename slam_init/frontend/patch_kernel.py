"""The compiled loops of :mod:`slam_init.frontend.patches`: patches are cut out of an image, and aligned with others."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quest.robust.kernels.compiler import compiler_of, inlined
from quest.robust.kernels.small_algebra import median_in_place, solve_in_place
from slam_init.types.arrays import Bools, Floats, Floats32, Ints

compiled = compiler_of(Path(__file__).parent)

#: Unknowns of an alignment: the displacement, the affine map (row by row, as displacements at the border of the patch),
#: and the mean and the contrast of the image.
UNKNOWNS = 8
#: Prior standard deviation of a step, px: along an edge a patch determines no displacement.
_STEP_PX = 0.5
#: Noise of a pixel in grey levels at least: rounding. A patch with less contrast is flat.
_LEAST_NOISE = 1.0
#: Rounding of a place that is the sum of some steps, px.
_ROUNDING_PX = 1e-6
#: The next pixel of a line, as an unsigned number.
_NEXT = np.uint64(1)
#: Rounds of the robust fit of the means of maps, and the deviations from which on a patch has less weight.
_ROUNDS, _FAR_SIGMAS = 3, 2.0
#: Tracks on a line do not determine the means across it: their slopes have this share of the information as a prior.
_RIDGE = 1e-6
#: Median of the squares of Gaussian numbers.
_MEDIAN_SQUARE = 0.455
#: Steps of an alignment, and the squared displacement (px^2) from which on they end: a hundredth of a pixel.
_STEPS, _CONVERGED = 6, 1e-4


@inlined
def sample_line(
    greys: Floats32, width: int, x: float, y: float, by_x: float, by_y: float, corners: Ints,
    parts: Floats | Floats32, line: Floats | Floats32,
) -> None:  # fmt: skip
    """Sample an image between its pixels, along a line from a place on.

    Shapes: ``greys`` (H W,), ``corners`` (K,), ``parts`` (2, K), ``line`` (K,).

    * ``corners, parts``: Room for the pixel to the upper left of each place, and for the place's distances from it.
    """
    # Two loops: the first one has no reads that depend on what it computes, so the processor does some places at once.
    for i in range(len(line)):
        at_x, at_y = x + by_x * i, y + by_y * i
        column, row = np.int32(at_x), np.int32(at_y)
        parts[0, i], parts[1, i] = at_x - column, at_y - row
        corners[i] = row * width + column
    for i in range(len(line)):
        # An unsigned index needs no test whether it counts from the end.
        above, below = np.uint64(corners[i]), np.uint64(corners[i] + width)
        upper = greys[above] + parts[0, i] * (greys[above + _NEXT] - greys[above])
        lower = greys[below] + parts[0, i] * (greys[below + _NEXT] - greys[below])
        line[i] = upper + parts[1, i] * (lower - upper)


@compiled
def cut_patches(
    image: Floats32, pixels: Floats, slots: Ints, radius: int, patches: Floats32, inverses: Floats, brightness: Floats
) -> Bools:
    """Cut patches out of an image, with their slopes and the inverses of their normal equations.

    Shapes: ``image`` (H, W), ``pixels`` (N, 2), ``slots`` (N,), ``patches`` (S, 3, K), ``inverses`` (S, 8, 8),
    ``brightness`` (S, 2), returns (N,).

    * ``patches``: The grey levels less the mean, over the contrast, and the two slopes, row by row.
    * ``brightness``: Mean and contrast (standard deviation) of a patch.
    * Returns: Whether each patch was cut: it lies in the image and is not flat.
    """
    height, width = image.shape
    side, reach = 2 * radius + 1, radius + 2.0
    cut, greys = np.zeros(len(pixels), np.bool_), image.reshape(-1)
    around, J = np.empty((side + 2, side + 2)), np.empty(UNKNOWNS)
    normal, corners, parts = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(side + 2, np.int64), np.empty((2, side + 2))
    for n in range(len(pixels)):
        x, y, slot = pixels[n, 0], pixels[n, 1], slots[n]
        if not (x >= reach and y >= reach and x < width - 1 - reach and y < height - 1 - reach):
            continue
        for j in range(side + 2):
            sample_line(greys, width, x - radius - 1, y + (j - radius - 1), 1.0, 0.0, corners, parts, around[j])
        inner = around[1:-1, 1:-1]
        mean, contrast = inner.mean(), inner.std()
        if contrast < _LEAST_NOISE:
            continue
        cut[n] = True
        brightness[slot, 0], brightness[slot, 1] = mean, contrast
        normal[:] = 0.0
        for k in range(side * side):
            j, i = k // side, k % side
            J[0] = 0.5 * (around[j + 1, i + 2] - around[j + 1, i])
            J[1] = 0.5 * (around[j + 2, i + 1] - around[j, i + 1])
            across, down = (i - radius) / radius, (j - radius) / radius
            J[2], J[3], J[4], J[5] = J[0] * across, J[0] * down, J[1] * across, J[1] * down
            J[6], J[7] = 1.0, (inner[j, i] - mean) / contrast
            patches[slot, 0, k], patches[slot, 1, k], patches[slot, 2, k] = J[7], J[0], J[1]
            for p in range(UNKNOWNS):
                for q in range(p, UNKNOWNS):
                    normal[p, q] += J[p] * J[q]
        for p in range(UNKNOWNS):
            normal[p, p] += (_LEAST_NOISE / _STEP_PX) ** 2 if p < 6 else 0.0
            for q in range(p):
                normal[p, q] = normal[q, p]
        inverses[slot] = np.linalg.inv(normal)
    return cut


@inlined
def is_inside(at: Floats, radius: int, width: int, height: int) -> bool:
    """Whether all pixels of a patch lie in an image.

    Shapes: ``at`` (8,): place, affine map, mean and contrast.
    """
    reach_x, reach_y = radius * (abs(at[2]) + abs(at[3])), radius * (abs(at[4]) + abs(at[5]))
    inside_x = reach_x + _ROUNDING_PX <= at[0] < width - 1 - reach_x - _ROUNDING_PX
    inside_y = reach_y + _ROUNDING_PX <= at[1] < height - 1 - reach_y - _ROUNDING_PX
    return bool(inside_x and inside_y)


@inlined
def products_with_errors(
    greys: Floats32, width: int, at: Floats, patch: Floats32, corners: Ints, parts: Floats32, line: Floats32,
    columns: Floats32, sums: Floats,
) -> float:  # fmt: skip
    """Sums over a patch of its errors times their derivatives by the unknowns.

    Shapes: ``at, sums`` (8,), ``patch`` (3, K), ``columns`` (7, side); see :func:`sample_line`.

    * ``columns``: Room for the sums over each column of the patch. A processor adds some columns at once, in the same
      order on all processors.
    * Returns: The sum of the squares of the errors.
    """
    x, y, a, b, c, d = at[0], at[1], at[2], at[3], at[4], at[5]
    mean, contrast = np.float32(at[6]), np.float32(at[7])
    radius = len(line) // 2
    columns[:] = np.float32(0.0)
    for j in range(len(line)):
        down, row = float(j - radius) / radius, j * len(line)
        at_x, at_y = x + radius * (b * down - a), y + radius * (d * down - c)
        sample_line(greys, width, at_x, at_y, a, c, corners, parts, line)
        below = np.float32(down)
        for i in range(len(line)):
            error = line[i] - mean - contrast * patch[0, row + i]
            error_x, error_y = patch[1, row + i] * error, patch[2, row + i] * error
            columns[0, i] += error_x
            columns[1, i] += error_y
            columns[2, i] += error_x * below
            columns[3, i] += error_y * below
            columns[4, i] += error
            columns[5, i] += error * patch[0, row + i]
            columns[6, i] += error * error
    sums[:], square = 0.0, 0.0
    for i in range(len(line)):
        across = float(i - radius) / radius
        sums[0] += columns[0, i]
        sums[1] += columns[1, i]
        sums[2] += columns[0, i] * across
        sums[3] += columns[2, i]
        sums[4] += columns[1, i] * across
        sums[5] += columns[3, i]
        sums[6] += columns[4, i]
        sums[7] += columns[5, i]
        square += columns[6, i]
    return square


@inlined
def follow_inverse(at: Floats, step: Floats, radius: int) -> None:
    """Let the map of a patch be followed by the inverse of a step, in place.

    Shapes: ``at, step`` (8,).
    """
    a, b, c, d = at[2], at[3], at[4], at[5]
    e, f, g, h = 1.0 + step[2] / radius, step[3] / radius, step[4] / radius, 1.0 + step[5] / radius
    inverse = 1.0 / (e * h - f * g)
    e, f, g, h = h * inverse, -f * inverse, -g * inverse, e * inverse
    u, v = -(e * step[0] + f * step[1]), -(g * step[0] + h * step[1])
    at[0], at[1] = at[0] + a * u + b * v, at[1] + c * u + d * v
    at[2], at[3], at[4], at[5] = a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h


@compiled
def align_patches(
    image: Floats32,
    slots: Ints,
    radius: int,
    patches: Floats32,
    inverses: Floats,
    brightness: Floats,
    pixels: Floats,
    affine: Floats,
) -> Floats:
    """Align patches with an image, from the places and the affine maps that are given and moved.

    The inverse compositional method (Baker and Matthews, "Lucas-Kanade 20 years on", 2004): slopes and normal equations
    stay those of the patch.

    Shapes: ``slots`` (N,), ``pixels`` (N, 2), ``affine`` (N, 4), returns (N,).

    * Returns: Root of the mean square of what the last step leaves, as its linearization predicts, over the contrast;
      infinite where the alignment leaves the image or finds no contrast.
    """
    height, width = image.shape
    side = 2 * radius + 1
    greys, left = image.reshape(-1), np.full(len(slots), np.inf)
    corners, parts, line = np.empty(side, np.int64), np.empty((2, side), np.float32), np.empty(side, np.float32)
    columns = np.empty((7, side), np.float32)
    at, sums, step = np.empty(UNKNOWNS), np.empty(UNKNOWNS), np.empty(UNKNOWNS)
    for n in range(len(slots)):
        slot, remains = slots[n], np.inf
        at[:2], at[2:6], at[6:] = pixels[n], affine[n], brightness[slot]
        for _ in range(_STEPS):
            if not is_inside(at, radius, width, height):
                remains = np.inf
                break
            square = products_with_errors(greys, width, at, patches[slot], corners, parts, line, columns, sums)
            for p in range(UNKNOWNS):
                step[p] = 0.0
                for q in range(UNKNOWNS):
                    step[p] += inverses[slot, p, q] * sums[q]
                square -= sums[p] * step[p]
            at[6:] += step[6:]
            if not at[7] >= _LEAST_NOISE:
                remains = np.inf
                break
            remains = np.sqrt(max(square, 0.0)) / (side * at[7])
            # The slopes of the image are those of the patch times the ratio of the contrasts.
            for p in range(6):
                step[p] *= brightness[slot, 1] / at[7]
            follow_inverse(at, step, radius)
            if step[0] * step[0] + step[1] * step[1] < _CONVERGED:
                break
        left[n] = remains
        if np.isfinite(remains) and np.isfinite(at.sum()):
            pixels[n], affine[n] = at[:2], at[2:6]
    return left


@compiled
def covariances_in_image(slots: Ints, inverses: Floats, affine: Floats, variances: Floats) -> Floats:
    """Covariances of the places of patches and of their affine maps, row by row.

    A step of an alignment is that of the patch before its map: a displacement ``u`` moves the place by ``A u``, and a
    change ``D`` of the map moves it by ``A D``.

    Shapes: ``slots`` (N,), ``inverses`` (S, 8, 8), ``affine`` (N, 4), ``variances`` (N,), returns (N, 6, 6).

    * ``variances``: Of the grey levels.
    """
    covariances = np.empty((len(slots), 6, 6))
    for n in range(len(slots)):
        a, b, c, d = affine[n, 0], affine[n, 1], affine[n, 2], affine[n, 3]
        turned = covariances[n]
        turned[:] = variances[n] * inverses[slots[n], :6, :6]
        for first in (0, 2, 3):  # the place, then the columns of the map
            second = 1 if first == 0 else first + 2
            for k in range(6):
                x, y = turned[first, k], turned[second, k]
                turned[first, k], turned[second, k] = a * x + b * y, c * x + d * y
        for first in (0, 2, 3):
            second = 1 if first == 0 else first + 2
            for k in range(6):
                x, y = turned[k, first], turned[k, second]
                turned[k, first], turned[k, second] = a * x + b * y, c * x + d * y
    return covariances


@compiled
def conditioned_on_maps(covariances: Floats, scatter: Floats, deviations: Floats) -> tuple[Floats, Floats]:
    """Change places and affine maps by what the distribution of the maps tells.

    Shapes: ``covariances`` (N, 6, 6), ``scatter`` (4,), ``deviations`` (N, 4), returns ``changes, places`` (N, 6),
    (N, 2, 2).

    * ``scatter``: Variances of the deviations of the maps from their mean.
    * ``deviations``: Of the mean from each map; NaN for a patch that keeps its own map.
    * ``changes``: Of the place and of the map; ``places``: covariances of the places.
    """
    changes, places = np.zeros((len(covariances), 6)), np.empty((len(covariances), 2, 2))
    root, solved = np.empty((4, 4)), np.empty((4, 3))
    for n in range(len(covariances)):
        whole = covariances[n]
        places[n] = whole[:2, :2]
        if not np.isfinite(deviations[n].sum()):
            continue
        for i in range(4):  # Cholesky's root of the covariance of a map and its deviation
            for j in range(i + 1):
                left = whole[2 + i, 2 + j] + (scatter[i] if i == j else 0.0)
                for k in range(j):
                    left -= root[i, k] * root[j, k]
                root[i, j] = np.sqrt(left) if i == j else left / root[j, j]
        for i in range(4):
            solved[i, 0], solved[i, 1], solved[i, 2] = deviations[n, i], whole[2 + i, 0], whole[2 + i, 1]
        for q in range(3):
            for i in range(4):
                for k in range(i):
                    solved[i, q] -= root[i, k] * solved[k, q]
                solved[i, q] /= root[i, i]
            for i in range(3, -1, -1):
                for k in range(i + 1, 4):
                    solved[i, q] -= root[k, i] * solved[k, q]
                solved[i, q] /= root[i, i]
        for p in range(6):
            for i in range(4):
                changes[n, p] += whole[p, 2 + i] * solved[i, 0]
        for p in range(2):
            for q in range(2):
                for i in range(4):
                    places[n, p, q] -= whole[p, 2 + i] * solved[i, 1 + q]
    return changes, places


@compiled
def distribution_of_maps(places: Floats, maps: Floats, variances: Floats) -> tuple[Floats, Floats]:
    """The means of the affine maps of patches, a linear function of the place, and the variances of their deviations.

    Robust least squares: a map that is far from the mean weighs less, by Huber.

    Shapes: ``places`` (N, 2), ``maps, variances`` (N, 4), returns ``means, scatter`` (N, 4), (4,).

    * ``variances``: Of the errors of the maps.
    """
    count = len(places)
    basis, means, scatter = np.ones((count, 3)), np.empty((count, 4)), np.zeros(4)
    for p in range(2):
        spread = max(places[:, p].std(), 1.0)
        basis[:, 1 + p] = (places[:, p] - places[:, p].mean()) / spread
    weights, squares, normal, line = np.empty(count), np.empty(count), np.empty((3, 3)), np.empty(3)
    for q in range(4):
        errors = median_in_place(variances[:, q].copy())
        weights[:] = 1.0 / variances[:, q]
        for _ in range(_ROUNDS):
            normal[:], line[:] = 0.0, 0.0
            for i in range(count):
                for p in range(3):
                    weighted = weights[i] * basis[i, p]
                    line[p] += weighted * maps[i, q]
                    for r in range(3):
                        normal[p, r] += weighted * basis[i, r]
            for p in range(1, 3):
                normal[p, p] += _RIDGE * normal[0, 0]
            solve_in_place(normal, line)
            for i in range(count):
                means[i, q] = basis[i, 0] * line[0] + basis[i, 1] * line[1] + basis[i, 2] * line[2]
                squares[i] = (maps[i, q] - means[i, q]) ** 2
            scatter[q] = max(median_in_place(squares.copy()) / _MEDIAN_SQUARE - errors, 0.0)
            for i in range(count):
                variance = variances[i, q] + scatter[q]
                sigmas = np.sqrt(squares[i] / variance)
                weights[i] = min(_FAR_SIGMAS / max(sigmas, _FAR_SIGMAS), 1.0) / variance
    return means, scatter
