r"""Is the translation observable? A statement with an error rate, from residuals alone.

Let R0 be the rotation that fits the matches best, and d = n - R0 m the remaining displacement of a match. For a
rotation-only or static camera, d is the noise of two bearings: its **direction** on the sphere is uniform, whatever its
length. If the camera moved by t, every point moves along its own epipolar line, towards t or away from it. So a
translation shows in two ways:

*Near matches* (d within three standard deviations: noise and parallax have the same size). Compare the components of d
along the epipolar lines with those across. A small rotation w, three degrees of freedom, may reduce the latter:

    T = sum |d|^2 - 2 min_w sum (d - w x R0 m)_across^2 - 6 v,      z = T / sqrt(sum |d|^4 / 2)

v is the variance of a component of d, and 3 v the noise that the rotation removes on average. Given the lengths |d|, T
is a sum of |d|^2 cos 2 theta with uniform theta: its mean is 0, its variance as above, and its tails are lighter than
Gaussian ones for any lengths (E exp(s cos) = I0(s) <= exp(s^2/4)). So neither heavy tails of the noise nor its scale
matter.

But t was chosen, among all directions, to make the residuals across small. As a function of t, z(t) is a random field
on the projective plane, nearly Gaussian, with the gradient covariance Lambda(t) = 4 <g g^T>, g_i = (t x n_i) / |t x
n_i|^2 (the rate at which the direction of an epipolar line turns with t). The probability that the maximum of the field
exceeds z is the expected Euler characteristic of the set where the field exceeds z [A81]_, [W95]_:

    p_near = Q(z) + A (2 pi)^(-3/2) z exp(-z^2 / 2),        A = integral of sqrt(det Lambda) over the half sphere

with Q the Gaussian tail. A was computed for fields of view from 20 degrees to 360 degrees. It grows with the logarithm
of the number N of matches, since a line turns fast close to its epipole, and stays below 21 + 8 log(N / 10). The bound
is for the maximum over all t, so it holds however t was found.

*Far matches* (d beyond five standard deviations). A rotation explains none of them, so under the null hypothesis they
are outliers that agree with the epipolar lines by chance. Let mu be their expected number for an arbitrary motion. The
two degrees of freedom of t can make two of the W outliers fit exactly:

    p_far = W (W - 1) / 2 P(Poisson(mu) >= far - 2)

The standard deviation is estimated from the residuals across, which the choice of t made small. For the far matches it
is replaced by its upper confidence limit for the most favourable t (Wilson and Hilferty's approximation of chi-square).

The p value of the statement is 2 min(p_near, p_far). The two need not be independent.

References
----------
.. [A81] R. J. Adler, "The Geometry of Random Fields", 1981.
.. [W95] K. J. Worsley, "Estimating the number of peaks in a random field using the Hadwiger characteristic of excursion
   sets", Annals of Statistics 1995.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, exp, inf, isfinite, log, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quest.errors import InputError, as_floats, as_index, as_positive
from quest.geometry.epipolar import as_matches
from quest.geometry.quaternion import matrix_from_quaternion
from quest.robust import kernels
from quest.tails import gaussian_tail, poisson_tail

Floats = NDArray[np.float64]

#: Matches within this many standard deviations are near. This is the usual gate of inliers, so that the selection of
#: the inliers by their distance from an epipolar line has removed no near match.
_NEAR_SIGMAS = 3.0
#: Noise moves one match in 3e5 beyond five standard deviations (exp(-25/2)).
_FAR_SIGMAS = 5.0
#: Gaussian deviate of a probability of 1e-3 over all t: Q(4.4) = 5e-6 is 1e-3 divided by the 200 independent directions
#: of the field.
_FAVOURED_DEVIATE = 4.4
#: Exact bearings have residuals of a few 1e-16 after the fit of a rotation. These are rounding errors, and their
#: direction is not random.
_LEAST_NOISE_RAD = 1e-13
#: Scale of a kernel that gives all residuals the same weight.
_NO_KERNEL_RAD = 1e9
#: Steps of the fit of the rotation at one scale.
_ROTATION_STEPS = 4


@dataclass(frozen=True)
class ParallaxStatement:
    """Whether two views show a translation of the camera, and its length compared with the depths.

    Attributes
    ----------
    ratio : float
        a in "|t|/depth = a +- b": the mean over the matches of the length of the translation divided by the depth in
        camera 1, weighted by the squared sine of the angle between ray and t (the depth of a ray along t is unknown).
        NaN where all rays lie along t.
    ratio_sigma : float
        b, the standard deviation of a, from the noise and the covariance of R and t; the information that noise alone
        adds is subtracted. Infinite where the direction of t is not determined: the test may then show a translation
        whose length is unknown. Without a translation neither a nor b has a meaning.
    test_value : float
        z of the near matches: by how many standard deviations the displacements from a pure rotation are longer along
        the epipolar lines than across. Significant from about 3.5 to 4.5, not from 2, since t was chosen to make it
        large; the p value accounts for this choice.
    p_value : float
        Probability, or a bound on it, of such matches for a rotation-only or static camera.
    near, far : int
        Number of matches within three, and beyond five, standard deviations of the best rotation.
    noise_rad : float
        Standard deviation of a bearing, as given or estimated from the residuals across the epipolar lines.
    """

    ratio: float
    ratio_sigma: float
    test_value: float
    p_value: float
    near: int
    far: int
    noise_rad: float

    def observable(self, error_rate: float = 1e-3) -> bool:
        """Whether there is a translation.

        Parameters
        ----------
        error_rate : float
            Largest share of cameras without translation for which the answer is true.

        Returns
        -------
        bool
        """
        return self.p_value < error_rate


def parallax_statement(
    q_or_R: ArrayLike,
    t: ArrayLike,
    m: ArrayLike,
    n: ArrayLike,
    noise_rad: float | None = None,
    *,
    chance_matches: float = 0.0,
    wrong_matches: int = 450,
    rotation: ArrayLike | None = None,
    stated_noise_rad: float | None = None,
) -> ParallaxStatement:
    """Test whether the translation of a motion is observable, and estimate its length compared with the depths.

    Parameters
    ----------
    q_or_R : (4,) or (3, 3) float
        Rotation cam2_from_cam1 of the motion, refined on the matches, as a quaternion wxyz or as a matrix.
    t : (3,) float
        Its translation, of any norm but zero.
    m, n : (N, 3) float
        Bearings of the motion's inliers in camera 1 and camera 2, N >= 6, of any norm. Select them by their distance
        from the epipolar lines, at three standard deviations or more, not by their parallax.
    noise_rad : float, optional
        Standard deviation of a bearing in radians; by default it is estimated from the residuals.
    chance_matches : float
        Expected number of outliers among the inliers of an arbitrary motion: 0 for data without outliers, otherwise
        for example the mean count after shuffling n.
    wrong_matches : int
        Number of outliers from which the motion was chosen, those among the N and those left out together. An
        approximate number is enough; it should not be too small. The default makes 10^5 pairs.
    rotation : (3, 3) float, optional
        A rotation that explains the matches about as well as a rotation can: the start of the fit of R0. By default the
        fit starts at R.
    stated_noise_rad : float, optional
        Standard deviation of a bearing as the caller expects it, in radians. The upper confidence limit of the noise is
        not larger than this, nor smaller than the estimate. By default the residuals alone give the limit; a dozen of
        them hardly bound the noise.

    Returns
    -------
    ParallaxStatement

    Raises
    ------
    InputError
        If the shapes do not fit, N < 6, q or t is zero, R is no rotation, a number is not finite, noise_rad is not
        positive, or a count is negative.

    References
    ----------
    Derived in the module docstring, with [A81]_ and [W95]_.
    """
    m, n = as_matches(m, n, at_least=6)
    if m.ndim != 2:
        raise InputError(f"bearings have shape {m.shape}: give two arrays (N, 3)")
    R, t = as_rotation(q_or_R), as_direction(t)
    if noise_rad is not None:
        noise_rad = max(as_positive(noise_rad, "noise_rad", "a positive angle in radians, or None"), _LEAST_NOISE_RAD)
        if noise_rad > 1:
            raise InputError(f"noise_rad is {noise_rad:g}: give an angle of at most 1 rad, or None")
    chance = as_positive(chance_matches, "chance_matches", "an expected count, zero or more", or_zero=True)
    wrong = as_index(wrong_matches, "wrong_matches", at_least=0)

    if stated_noise_rad is not None:
        stated_noise_rad = as_positive(stated_noise_rad, "stated_noise_rad", "a positive angle in radians, or None")
    return statement_of_inliers(
        R,
        t,
        m,
        n,
        noise_rad,
        chance_matches=chance,
        wrong_matches=wrong,
        rotation=R if rotation is None else as_rotation(rotation),
        stated_noise_rad=stated_noise_rad,
    )


def statement_of_inliers(
    R: Floats,
    t: Floats,
    m: Floats,
    n: Floats,
    noise_rad: float | None,
    *,
    chance_matches: float,
    wrong_matches: int,
    rotation: Floats,
    stated_noise_rad: float | None,
) -> ParallaxStatement:
    """Make the statement of :func:`parallax_statement` from arguments that were checked.

    Shapes: ``R`` (3, 3), ``t`` (3,), ``m, n`` (N, 3), ``rotation`` (3, 3).
    """
    information, squares, *_ = kernels.pose_information(m, n, R, t, 1.0)
    noise = noise_rad if noise_rad is not None else max(sqrt(squares / (len(m) - 5)), _LEAST_NOISE_RAD)
    limit = _upper_noise(squares, len(m))
    if stated_noise_rad is not None:
        limit = min(limit, stated_noise_rad)
    largest_noise = noise_rad if noise_rad is not None else max(noise, limit)

    R0 = rotation.copy()
    kernels.rotation_of_all(m, n, R0, noise, _ROTATION_STEPS)
    near_rad, far_rad = _NEAR_SIGMAS * noise, _FAR_SIGMAS * largest_noise
    if noise_rad is not None:
        # The residuals may be much smaller than a stated noise, as those of exact data. Then the small pull that the
        # far matches have left on R0 is larger than the residuals, and it turns all of them alike, as no noise does:
        # 45 of 240 exact cameras that only rotate, with outliers, showed a translation.
        near_to = np.sum((n - m @ R0.T) ** 2, axis=1) < 2 * near_rad**2
        kernels.refine_rotation(m[near_to], n[near_to], R0, _NO_KERNEL_RAD, 1)
    sums, count, near, far = kernels.anisotropy_sums(m, n, R0, t, near_rad, far_rad, _LEAST_NOISE_RAD)
    z = _anisotropy_of_sums(sums, count)
    p_near = _chance_of_maximum(z, near)
    by_noise = len(m) * exp(-(_FAR_SIGMAS**2) / 2)
    # Under the null hypothesis the far matches themselves are outliers.
    pairs = comb(min(max(wrong_matches, far, 2), 2**53), 2)  # the range of a double; p_far is 1 long before that
    p_far = pairs * poisson_tail(far - 2, chance_matches + by_noise)
    ratio, sigma = _ratio_of_sums(*kernels.ratio_sums(m, n, R, t), information, noise)
    return ParallaxStatement(
        ratio=ratio,
        ratio_sigma=sigma,
        test_value=z,
        p_value=min(1.0, 2 * min(p_near, p_far)),
        near=near,
        far=far,
        noise_rad=noise,
    )


def as_rotation(q_or_R: ArrayLike) -> Floats:
    """The rotation as a matrix (3, 3), given as a quaternion or as a matrix."""
    given = as_floats(q_or_R, "the rotation")
    if given.shape not in ((4,), (3, 3)) or not np.isfinite(given).all():
        raise InputError(f"the rotation has shape {given.shape}: give a finite quaternion (4,) or a matrix (3, 3)")
    if given.shape == (4,):
        largest = np.abs(given).max()
        if largest == 0:
            raise InputError("the quaternion is zero: give one of any other norm")
        return matrix_from_quaternion(given / largest)
    # 1e-6 rad is a thousandth of a pixel. A matrix with larger errors was not meant as a rotation.
    if np.abs(given).max() > 2 or np.abs(given @ given.T - np.eye(3)).max() > 1e-6 or np.linalg.det(given) < 0:
        raise InputError("the matrix is no rotation: give an orthogonal one of determinant 1")
    return given


def as_direction(t: ArrayLike) -> Floats:
    """A translation (3,) at unit norm."""
    given = as_floats(t, "t")
    if given.shape != (3,) or not np.isfinite(given).all() or not given.any():
        raise InputError(f"t of shape {given.shape}: give three finite numbers, not all zero")
    scaled = given / np.abs(given).max()
    return np.asarray(scaled / np.linalg.norm(scaled))


def _upper_noise(squares: float, count: int) -> float:
    """Upper limit of the noise from the sum of squares across the epipolar lines of the most favourable t."""
    dof = count - 3
    least = dof * (1 - 2 / (9 * dof) - _FAVOURED_DEVIATE * sqrt(2 / (9 * dof))) ** 3
    return sqrt(squares / least) if least > 0 else inf


def _anisotropy_of_sums(sums: Floats, count: int) -> float:
    """The z of the module docstring, from the sums of ``kernels.anisotropy_sums``."""
    if count < 4:
        return 0.0
    total, fourth, across2 = sums[4].tolist()
    values, vectors = eigen_of(sums[:3])
    parts = sums[3] @ vectors
    used = values > 1e-12 * values.max()
    # What the best rotation leaves of the squares across: |y|^2 - y^T J (J^T J)^-1 J^T y.
    rest = max(across2 - float(np.sum(parts[used] ** 2 / values[used])), 0.0)
    return float((total - 2 * rest - 6 * total / (2 * count - 3)) / sqrt(0.5 * fourth))


def eigen_of(A: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (N,) and eigenvectors (N, N), as columns, of a small symmetric matrix; numpy takes 20 us a call."""
    A, vectors = A.copy(), np.empty_like(A)
    kernels.eigen_in_place(A, vectors)
    return A.diagonal(), vectors


def _chance_of_maximum(z: float, count: int) -> float:
    """Bound on the probability that the maximum over t of the field of z exceeds z."""
    if z <= 1:
        return 1.0  # the Euler characteristic is no bound there
    area = 21 + 8 * log(max(count, 10) / 10)
    return min(1.0, gaussian_tail(z) + area * z * exp(-z * z / 2) / sqrt(2 * pi) ** 3)


def _ratio_of_sums(
    shift: float, weight: float, sums: Floats, by_noise: Floats, raw: Floats, noise_rad: float
) -> tuple[float, float]:
    """The weighted mean of |t| / depth and its deviation, from the sums of ``kernels.ratio_sums`` and J^T J (5, 5).

    The mean is NaN where all rays lie along t; the deviation is infinite where the direction of t is not determined.
    The contribution of noise to J^T J is subtracted: the derivative by t is a x n, whose length is parallax plus noise,
    and with it the direction would appear to be known where there is no parallax at all.
    """
    if weight == 0:
        return float("nan"), inf
    ratio = shift / weight
    # The derivatives of the ratio by the motion, and the information about the motion.
    gradient = np.concatenate([-sums[:3], sums[3:5] - 2 * ratio * sums[5:]]) / weight
    information = raw.copy()
    information[3:, 3:] -= 2 * noise_rad**2 * by_noise
    values, vectors = eigen_of(information)
    if values.min() <= 1e-12 * values.max():
        return ratio, inf
    image = (vectors / values) @ (vectors.T @ gradient)
    sigma = noise_rad * sqrt(float(image @ raw @ image) + 2 / weight)
    return ratio, sigma if isfinite(sigma) else inf
