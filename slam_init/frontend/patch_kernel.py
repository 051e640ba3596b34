"""The compiled loops of tracking.

Those of :mod:`slam_init.frontend.patches`: patches are cut out of an image, and aligned with others. That of
:func:`slam_init.frontend.flow.gradient_products`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quest.algebra import median_in_place, solve_in_place
from quest.jit import compiler_of, inlined
from slam_init.frontend.patch_size import SIDE_PX, UNKNOWNS, WIDE
from slam_init.types.arrays import Bools, Floats, Floats32, Image, Ints, Ints32, Pairs

#: The loops hold no sums, deviations and copies of slices: for four of these numba compiled 46 functions more.
compiled = compiler_of(Path(__file__).parent)

#: Pixels from the centre of a patch to its border.
_RADIUS = SIDE_PX // 2
#: Of the displacement and the map: whether the slope is the one down, and whether it is times the place across or down.
_SLOPE, _ACROSS, _DOWN = (0, 1, 0, 0, 1, 1), (0, 0, 1, 0, 1, 0), (0, 0, 0, 1, 0, 1)
#: Prior standard deviation of a step, px: along an edge a patch determines no displacement.
_STEP_PX = 0.5
#: Noise of a pixel in grey levels at least: rounding. A patch with less contrast is flat.
_LEAST_NOISE = 1.0
#: Rounding of a place in single precision, px: a hundred times as much as 64 px from the corner that it counts from.
_ROUNDING_PX = 1e-3
#: The grey level of a pixel within a pair.
_GREY, _GREY_BITS = np.int32(255), np.int32(8)
#: Rounds of the robust fit of the means of maps, and the deviations from which on a patch has less weight.
_ROUNDS, _FAR_SIGMAS = 3, 2.0
#: Tracks on a line do not determine the means across it: their slopes have this share of the information as a prior.
_RIDGE = 1e-6
#: Median of the squares of Gaussian numbers.
_MEDIAN_SQUARE = 0.455
#: Steps of an alignment, and the squared displacement (px^2) from which on they end: a hundredth of a pixel.
_STEPS, _CONVERGED = 6, 1e-4


@inlined
def grey(value: int) -> np.float32:
    """A grey level in single precision: from 32 bits, as a processor converts eight at once."""
    return np.float32(np.int32(value))


@inlined
def sample_line(
    pairs: Pairs, width: int, corner: int, place: tuple[float, float], step: tuple[float, float], last: int,
    corners: Ints32, uppers: Ints32, across: Floats32, down: Floats32, line: Floats32,
) -> None:  # fmt: skip
    """Sample an image between its pixels, at places along a line; the last of them again to the end of the room.

    Shapes: ``pairs`` (H W - 1,), the room and ``line`` (WIDE,).

    * ``pairs``: Each pixel with the one to its right (:func:`slam_init.frontend.patches.pairs_of`).
    * ``corner``: The pixel that ``place`` counts from, to the upper left of all places.
    * ``corners, uppers, across, down``: Room for the pixels to the upper left of the places, for what they show, and
      for the distances of the places from them.
    """
    # The first loop and the last one read nothing at an index that they compute, so a processor does eight places at
    # once. Single precision is enough near the corner.
    w, first = np.int32(width), np.int32(corner)
    x, y, by_x, by_y = np.float32(place[0]), np.float32(place[1]), np.float32(step[0]), np.float32(step[1])
    for i in range(WIDE):
        steps = np.float32(min(i, last))
        at_x, at_y = x + by_x * steps, y + by_y * steps
        column, row = np.int32(at_x), np.int32(at_y)
        across[i], down[i] = at_x - np.float32(column), at_y - np.float32(row)
        corners[i] = first + row * w + column
    for i in range(WIDE):
        # An unsigned index needs no test whether it counts from the end.
        above, below = np.uint32(corners[i]), np.uint32(corners[i] + w)
        uppers[i], corners[i] = np.int32(pairs[above]), np.int32(pairs[below])
    for i in range(WIDE):
        left, right = grey(uppers[i] & _GREY), grey(uppers[i] >> _GREY_BITS)
        upper = left + across[i] * (right - left)
        left, right = grey(corners[i] & _GREY), grey(corners[i] >> _GREY_BITS)
        lower = left + across[i] * (right - left)
        line[i] = upper + down[i] * (lower - upper)


@compiled
def cut_patches(
    pairs: Pairs, size: Ints, pixels: Floats, slots: Ints, patches: Floats32, inverses: Floats, brightness: Floats,
) -> Bools:  # fmt: skip
    """Cut patches out of an image, with their slopes and the inverses of their normal equations.

    Shapes: ``pairs`` (H W - 1,), ``size`` (2,), ``pixels`` (N, 2), ``slots`` (N,), ``patches``
    (S, 3, SIDE_PX, WIDE), ``inverses`` (S, 8, 8), ``brightness`` (S, 2), returns (N,).

    * ``size``: Height and width of the image.
    * ``patches``: The grey levels less the mean, over the contrast, and the two slopes; zero beyond the side.
    * ``brightness``: Mean and contrast (standard deviation) of a patch.
    * Returns: Whether each patch was cut: it lies in the image and is not flat.
    """
    height, width = size[0], size[1]
    reach, cut = _RADIUS + 2.0, np.zeros(len(pixels), np.bool_)
    corners, uppers = np.empty(WIDE, np.int32), np.empty(WIDE, np.int32)
    across, down = np.empty(WIDE, np.float32), np.empty(WIDE, np.float32)
    around, columns = np.empty((SIDE_PX + 2, WIDE), np.float32), np.empty((17, WIDE))
    for n in range(len(pixels)):
        x, y, slot = pixels[n, 0], pixels[n, 1], slots[n]
        if not (x >= reach and y >= reach and x < width - 1 - reach and y < height - 1 - reach):
            continue
        column, row = int(x) - _RADIUS - 1, int(y) - _RADIUS - 1
        x, y = x - _RADIUS - 1 - column, y - _RADIUS - 1 - row
        for j in range(SIDE_PX + 2):
            corner = (row + j) * width + column
            sample_line(pairs, width, corner, (x, y), (1.0, 0.0), SIDE_PX + 1, corners, uppers, across, down, around[j])
        mean, contrast = brightness_of(around)
        if contrast < _LEAST_NOISE:
            continue
        cut[n] = True
        brightness[slot, 0], brightness[slot, 1] = mean, contrast
        columns[:] = 0.0
        for j in range(SIDE_PX):
            sums_of_line(around, j, mean, contrast, patches[slot], columns)
        invert_sums(columns, inverses[slot])
    return cut


@inlined
def brightness_of(around: Floats32) -> tuple[float, float]:
    """Mean and standard deviation of the grey levels within the border of a patch."""
    total, square = 0.0, 0.0
    for j in range(1, SIDE_PX + 1):
        for i in range(1, SIDE_PX + 1):
            total += around[j, i]
            square += around[j, i] * around[j, i]
    mean = total / SIDE_PX**2
    return mean, np.sqrt(max(square / SIDE_PX**2 - mean * mean, 0.0))


@inlined
def sums_of_line(around: Floats32, j: int, mean: float, contrast: float, patch: Floats32, columns: Floats) -> None:
    """Take a line of a patch from the grey levels around it, and add it to the sums over each column.

    Shapes: ``patch`` (3, SIDE_PX, WIDE), ``columns`` (17, WIDE).

    * ``columns``: Of the products of the slopes (xx, xy, yy), times 1, the place down the column, and its square; of
      the slopes and of their products with the grey level, times 1 and the place.
    """
    down = (j - _RADIUS) / _RADIUS
    for i in range(SIDE_PX):
        x = 0.5 * (around[j + 1, i + 2] - around[j + 1, i])
        y = 0.5 * (around[j + 2, i + 1] - around[j, i + 1])
        grey_level = (around[j + 1, i + 1] - mean) / contrast
        patch[0, j, i], patch[1, j, i], patch[2, j, i] = grey_level, x, y
        for k, product in enumerate((x * x, x * y, y * y)):
            columns[3 * k, i] += product
            columns[3 * k + 1, i] += product * down
            columns[3 * k + 2, i] += product * down * down
        for k, product in enumerate((x, y, x * grey_level, y * grey_level)):
            columns[9 + 2 * k, i] += product
            columns[10 + 2 * k, i] += product * down


@inlined
def sum_across(column: Floats, power: int) -> float:
    """The sum over the columns of a patch, times a power (0 to 2) of the place across."""
    total = 0.0
    for i in range(SIDE_PX):
        across = (i - _RADIUS) / _RADIUS
        total += column[i] * (1.0 if power == 0 else across if power == 1 else across * across)
    return total


@inlined
def invert_sums(columns: Floats, inverse: Floats) -> None:
    """The inverse (8, 8) of normal equations, from the sums over each column of a patch, by Gauss-Jordan.

    They are positive definite with the priors of the steps, so that no pivot is sought.
    """
    for p in range(6):
        for q in range(p, 6):
            products = columns[3 * (_SLOPE[p] + _SLOPE[q]) + _DOWN[p] + _DOWN[q]]
            inverse[p, q] = inverse[q, p] = sum_across(products, _ACROSS[p] + _ACROSS[q])
        inverse[p, p] += (_LEAST_NOISE / _STEP_PX) ** 2
        for q in range(6, UNKNOWNS):
            slopes = columns[9 + 4 * (q - 6) + 2 * _SLOPE[p] + _DOWN[p]]
            inverse[p, q] = inverse[q, p] = sum_across(slopes, _ACROSS[p])
    # The grey levels have the mean 0 and the mean square 1.
    inverse[6, 6], inverse[7, 7], inverse[6, 7], inverse[7, 6] = SIDE_PX**2, SIDE_PX**2, 0.0, 0.0
    for k in range(UNKNOWNS):
        pivot = 1.0 / inverse[k, k]
        inverse[k, k] = 1.0
        for q in range(UNKNOWNS):
            inverse[k, q] *= pivot
        for p in range(UNKNOWNS):
            if p != k:
                factor, inverse[p, k] = inverse[p, k], 0.0
                for q in range(UNKNOWNS):
                    inverse[p, q] -= factor * inverse[k, q]


@inlined
def reach_of(at: Floats) -> tuple[float, float]:
    """How far the pixels of a patch lie from its place, px.

    Shapes: ``at`` (8,): place, affine map, mean and contrast.
    """
    return _RADIUS * (abs(at[2]) + abs(at[3])), _RADIUS * (abs(at[4]) + abs(at[5]))


@inlined
def is_inside(at: Floats, width: int, height: int) -> bool:
    """Whether all pixels of a patch lie in an image.

    Shapes: ``at`` (8,).
    """
    reach_x, reach_y = reach_of(at)
    inside_x = reach_x + _ROUNDING_PX <= at[0] < width - 1 - reach_x - _ROUNDING_PX
    inside_y = reach_y + _ROUNDING_PX <= at[1] < height - 1 - reach_y - _ROUNDING_PX
    return bool(inside_x and inside_y)


@inlined
def products_with_errors(
    pairs: Pairs, width: int, at: Floats, patch: Floats32, corners: Ints32, uppers: Ints32, across: Floats32,
    down: Floats32, line: Floats32, columns: Floats32, sums: Floats,
) -> float:  # fmt: skip
    """Sums over a patch of its errors times their derivatives by the unknowns.

    Shapes: ``at, sums`` (8,), ``patch`` (3, SIDE_PX, WIDE), ``columns`` (7, WIDE); see :func:`sample_line`.

    * ``columns``: Room for the sums over each column of the patch. A processor adds some columns at once, in the same
      order on all processors.
    * Returns: The sum of the squares of the errors.
    """
    reach_x, reach_y = reach_of(at)
    column, row = int(at[0] - reach_x), int(at[1] - reach_y)
    corner, x, y = row * width + column, at[0] - column, at[1] - row
    mean, contrast = np.float32(at[6]), np.float32(at[7])
    columns[:] = np.float32(0.0)
    for j in range(SIDE_PX):
        below = np.float32((j - _RADIUS) / _RADIUS)
        place = x + at[3] * (j - _RADIUS) - at[2] * _RADIUS, y + at[5] * (j - _RADIUS) - at[4] * _RADIUS
        sample_line(pairs, width, corner, place, (at[2], at[4]), SIDE_PX - 1, corners, uppers, across, down, line)
        for i in range(WIDE):
            error = line[i] - mean - contrast * patch[0, j, i]
            error_x, error_y = patch[1, j, i] * error, patch[2, j, i] * error
            columns[0, i] += error_x
            columns[1, i] += error_y
            columns[2, i] += error_x * below
            columns[3, i] += error_y * below
            columns[4, i] += error
            columns[5, i] += error * patch[0, j, i]
            columns[6, i] += error * error
    sums[:], square = 0.0, 0.0
    for i in range(SIDE_PX):
        right = (i - _RADIUS) / _RADIUS
        sums[0] += columns[0, i]
        sums[1] += columns[1, i]
        sums[2] += columns[0, i] * right
        sums[3] += columns[2, i]
        sums[4] += columns[1, i] * right
        sums[5] += columns[3, i]
        sums[6] += columns[4, i]
        sums[7] += columns[5, i]
        square += columns[6, i]
    return square


@inlined
def follow_inverse(at: Floats, step: Floats) -> None:
    """Let the map of a patch be followed by the inverse of a step, in place.

    Shapes: ``at, step`` (8,).
    """
    a, b, c, d = at[2], at[3], at[4], at[5]
    e, f, g, h = 1.0 + step[2] / _RADIUS, step[3] / _RADIUS, step[4] / _RADIUS, 1.0 + step[5] / _RADIUS
    inverse = 1.0 / (e * h - f * g)
    e, f, g, h = h * inverse, -f * inverse, -g * inverse, e * inverse
    u, v = -(e * step[0] + f * step[1]), -(g * step[0] + h * step[1])
    at[0], at[1] = at[0] + a * u + b * v, at[1] + c * u + d * v
    at[2], at[3], at[4], at[5] = a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h


@compiled
def align_patches(
    pairs: Pairs, size: Ints, slots: Ints, patches: Floats32, inverses: Floats, brightness: Floats, places: Floats
) -> Floats:
    """Align patches with an image, from the places and the affine maps that are given and moved.

    The inverse compositional method (Baker and Matthews, "Lucas-Kanade 20 years on", 2004): slopes and normal equations
    stay those of the patch.

    Shapes: ``pairs`` (H W - 1,), ``size`` (2,), ``slots`` (N,), ``places`` (N, 6), returns (N,); see
    :func:`cut_patches`.

    * ``places``: Pixels and affine maps.
    * Returns: Root of the mean square of what the last step leaves, as its linearization predicts, over the contrast;
      infinite where the alignment leaves the image or finds no contrast.
    """
    height, width, left = size[0], size[1], np.full(len(slots), np.inf)
    corners, uppers = np.empty(WIDE, np.int32), np.empty(WIDE, np.int32)
    across, down = np.empty(WIDE, np.float32), np.empty(WIDE, np.float32)
    line, columns = np.empty(WIDE, np.float32), np.empty((7, WIDE), np.float32)
    at, sums, step = np.empty(UNKNOWNS), np.empty(UNKNOWNS), np.empty(UNKNOWNS)
    for n in range(len(slots)):
        slot, remains = slots[n], np.inf
        for p in range(UNKNOWNS):
            at[p] = places[n, p] if p < 6 else brightness[slot, p - 6]
        for _ in range(_STEPS):
            if not is_inside(at, width, height):
                remains = np.inf
                break
            square = products_with_errors(
                pairs, width, at, patches[slot], corners, uppers, across, down, line, columns, sums
            )
            for p in range(UNKNOWNS):
                step[p] = 0.0
                for q in range(UNKNOWNS):
                    step[p] += inverses[slot, p, q] * sums[q]
                square -= sums[p] * step[p]
            at[6], at[7] = at[6] + step[6], at[7] + step[7]
            if not at[7] >= _LEAST_NOISE:
                remains = np.inf
                break
            remains = np.sqrt(max(square, 0.0)) / (SIDE_PX * at[7])
            # The slopes of the image are those of the patch times the ratio of the contrasts.
            for p in range(6):
                step[p] *= brightness[slot, 1] / at[7]
            follow_inverse(at, step)
            if step[0] * step[0] + step[1] * step[1] < _CONVERGED:
                break
        left[n], total = remains, 0.0
        for p in range(UNKNOWNS):
            total += at[p]
        if np.isfinite(remains) and np.isfinite(total):
            for p in range(6):
                places[n, p] = at[p]
    return left


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
        total, square = 0.0, 0.0
        for i in range(count):
            total += places[i, p]
        mean = total / count
        for i in range(count):
            square += (places[i, p] - mean) * (places[i, p] - mean)
        spread = max(np.sqrt(square / count), 1.0)
        for i in range(count):
            basis[i, 1 + p] = (places[i, p] - mean) / spread
    weights, squares, normal, line = np.empty(count), np.empty(count), np.empty((3, 3)), np.empty(3)
    for q in range(4):
        errors = median_in_place(variances[:, q].copy())
        for i in range(count):
            weights[i] = 1.0 / variances[i, q]
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


@inlined
def mirrored(index: int, last: int) -> int:
    """An index of a row that goes on mirrored at both ends, without these twice."""
    while index < 0 or index > last:
        index = -index if index < 0 else 2 * last - index
    return index


@compiled
def sums_of_products(image: Image, centres: Ints, radius: int, step: int) -> Ints:
    """Sums over patches of the products of the gradients, at each ``step``-th pixel of each row and column.

    Shapes: ``image`` (H, W), ``centres`` (N, 2), returns (N, 3).

    * ``centres``: Row and column, in steps.
    * ``radius``: Of a patch, in steps.
    * Returns: Of dx dx, dx dy and dy dy, with gradients that are eight times the slope (Sobel's).
    """
    height, width = image.shape
    last_row, last_column = (height - 1) // step, (width - 1) // step
    sums = np.zeros((len(centres), 3), np.int64)
    for n in range(len(centres)):
        xx, xy, yy = np.int64(0), np.int64(0), np.int64(0)
        for j in range(-radius, radius + 1):
            row = step * mirrored(centres[n, 0] + j, last_row)
            above, below = mirrored(row - 1, height - 1), mirrored(row + 1, height - 1)
            for i in range(-radius, radius + 1):
                column = step * mirrored(centres[n, 1] + i, last_column)
                left, right = mirrored(column - 1, width - 1), mirrored(column + 1, width - 1)
                falling = np.int64(image[below, right]) - np.int64(image[above, left])
                rising = np.int64(image[above, right]) - np.int64(image[below, left])
                dx = falling + rising + 2 * (np.int64(image[row, right]) - np.int64(image[row, left]))
                dy = falling - rising + 2 * (np.int64(image[below, column]) - np.int64(image[above, column]))
                xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
        sums[n, 0], sums[n, 1], sums[n, 2] = xx, xy, yy
    return sums
