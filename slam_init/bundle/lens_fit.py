"""The lens of all frames of a stretch of video: a bundle adjustment whose lens is free.

Where a camera drives straight ahead, each frame has little information about the focal length: a longer lens sees a
scene that is stretched along the optical axis in the same way. Where the lens bends strongly, a polynomial with one
coefficient fits the centre of the image or its border. All frames of some seconds together determine both, by matches
that do not drift. Unknown are the poses, the points, the focal length, two coefficients of the radial distortion, and
the principal point. The lens has a prior. With a point ``X`` of homogeneous coordinates (unit length, so that points at
infinity are points like any other) ::

    P = R_k X[:3] + X[3] t_k        x = P[:2] / P[2]        pixel = f x (1 + k1 |x|^2 + k2 |x|^4) + c

The robust cost is Cauchy's, with the noise that the residuals show. The points are eliminated (Schur complement). The
deviations are the largest of three: by the curvature of the cost, and by the scatter of the scores of single tracks and
of the regions of the image (White 1980), which knows errors that neighbours share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from quest.descent import descend
from quest.geometry.quaternion import rotation_from_vector
from slam_init.bundle.least_squares import CAUCHY
from slam_init.bundle.problem import MEDIAN_SQUARE
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.lens import PULL_FREEDOM, UNKNOWN_K1_SIGMA

#: Standard deviation of k2 of a lens of which nothing is known: wide lenses have one of up to the square of their k1.
#: Class: assumption.
_K2_SIGMA = 0.1
#: The same of the principal point about the centre, over the width of the image: the optical axis of phones is off by a
#: hundredth.
#: Class: assumption, over the width.
_PRINCIPAL_SIGMA = 0.01
#: Factor on the deviations: matches of a scene have errors in common that no region knows, such as repeated texture.
#: Class: assumption.
_OPTIMISM = 2.0
#: Relative deviation of the focal length by what the model of the lens leaves out.
#: Class: measured.
_MODEL_SIGMA = 0.03
#: Parts of the image (columns, rows) whose errors are independent.
#: Class: assumption.
_REGIONS = (4, 3)
#: Levenberg-Marquardt: first damping and its largest value, largest number of steps, and the decrease of the cost below
#: which it ends: a fortieth of a nat.
_DAMPING, _MOST_DAMPING, _STEPS, _TOLERANCE = 1e-4, 1e4, 15, 0.05
#: A robust cost converges linearly, and the focal length lies in a long valley: multiples of a step that are tried.
_LENGTHS = (2.0, 4.0, 8.0)
#: How often the noise is measured again, until it changes by less than a twentieth. No tracker is better than the last
#: number, in pixels.
_NOISE_ROUNDS, _NOISE_TOLERANCE, _LEAST_NOISE_PX = 10, 0.05, 0.03
#: Least growth of the distorted radius, and largest tangent, where a lens sees.
_LEAST_GROWTH, _LARGEST_TANGENT = 0.05, 5.0
#: Largest cost of an observation, that of a point behind a camera: a residual of twelve times the noise.
_LARGEST_COST = 20.0
#: Stiffness of the held baseline over that of its view.
_GAUGE = 1e4
#: log f, k1, k2, and the principal point.
_LENS = 5
#: R, t, X of :class:`Matches`, and the lens.
_State: TypeAlias = tuple[Floats, Floats, Floats, Floats]


class Matches(NamedTuple):
    """The observations of points in the views, and a start."""

    #: views, points: (N,) Of each observation.
    views: Ints
    points: Ints
    #: (N, 2) Raw pixels.
    pixels: Floats
    #: R, t: (V, 3, 3), (V, 3) Cam_from_world.
    R: Floats
    t: Floats
    #: (T, 4) Homogeneous, of unit length.
    X: Floats


@dataclass(frozen=True)
class LensEstimate:
    """The lens by a stretch of video."""

    focal_px: float
    #: Relative standard deviation.
    focal_sigma: float
    #: k1, k1_sigma, k2: The radial distortion in OpenCV's convention.
    k1: float
    k1_sigma: float
    k2: float
    #: Share of the observations within three standard deviations.
    inliers: float


def fit_lens(matches: Matches, start: Camera, prior: Camera) -> LensEstimate | None:
    """Fit the lens of all views.

    * ``start``: The camera by which the poses of the start were found.
    * ``prior``: What is known before, with ``focal_sigma``. The principal point stays the one of its images, so that it
      is an unknown of the fit, and no part of the result.
    * Returns: None where the equations have no solution.
    """
    try:
        fit = _Fit(matches, start, prior)
        for _ in range(_NOISE_ROUNDS):
            ended = fit.optimize()
            before, fit.noise_px = fit.noise_px, fit.measured_noise_px()
            if ended and abs(math.log(fit.noise_px / before)) < _NOISE_TOLERANCE:
                break
        return fit.estimate()
    except np.linalg.LinAlgError:
        return None


class _Fit:
    """The unknowns and the equations; the lens is held relative to the camera of the start."""

    def __init__(self, matches: Matches, start: Camera, prior: Camera) -> None:
        order = np.lexsort((matches.views, matches.points))
        self._views, self._points, self._measured = (one[order] for one in matches[:3])
        self._of_point = np.unique(self._points, return_index=True)
        self._by_view = np.argsort(self._views, kind="stable")
        self._of_view = np.unique(self._views[self._by_view], return_index=True)
        self._focal_px, self._centre = start.focal_px, np.array([prior.cx, prior.cy])
        k1, k2 = (*start.distortion, 0.0, 0.0)[:2]
        self._state: _State = (matches.R, matches.t, matches.X, np.array([0.0, k1, k2, 0.0, 0.0]))
        known = (*prior.distortion, 0.0, 0.0)[:2]
        self._mean = np.array([math.log(prior.focal_px / start.focal_px), *known, 0.0, 0.0])
        principal_px = _PRINCIPAL_SIGMA * prior.width
        self._sigma = np.array([prior.focal_sigma or 1.0, UNKNOWN_K1_SIGMA, _K2_SIGMA, principal_px, principal_px])
        size = np.array([prior.width, prior.height]) / _REGIONS
        place = np.minimum(self._measured[self._of_point[1]] // size, np.array(_REGIONS) - 1).astype(int)
        self._regions = np.zeros((math.prod(_REGIONS), len(matches.X)))
        self._regions[place @ (_REGIONS[1], 1), self._of_point[0]] = 1.0
        self._first = 6 * len(matches.R)
        self.noise_px = 1.0
        self.noise_px = self.measured_noise_px()

    # -- optimization -----------------------------------------------------------------------------------------------

    def optimize(self) -> bool:
        """Go down to the optimum; returns whether that took fewer steps than the largest number."""
        start, equations = self._state, self._equations()

        def step(at: _State, damping: float) -> tuple[_State, float]:
            nonlocal equations
            if at is not self._state:
                self._state = at
                equations = self._equations()
            return self._farthest(equations, damping)

        self._state, costs = descend(
            start, self._cost(start), step, steps=_STEPS, damping=_DAMPING, most_damping=_MOST_DAMPING,
            least_decrease=_TOLERANCE,
        )  # fmt: skip
        return len(costs) <= _STEPS

    def measured_noise_px(self) -> float:
        """The noise by the median residual."""
        squares = self._squares(self._state)
        median = float(np.median(squares)) * self.noise_px**2 / MEDIAN_SQUARE
        return max(math.sqrt(median), _LEAST_NOISE_PX)

    def _squares(self, state: _State) -> Floats:
        pixels, seen, _ = self._projected(state, differentiate=False)
        squares = np.sum((pixels - self._measured) ** 2, axis=1) / self.noise_px**2
        return np.asarray(np.where(seen, squares, np.inf))

    def _cost(self, state: _State) -> float:
        costs = CAUCHY**2 * np.log1p(self._squares(state) / CAUCHY**2)
        pulls = (state[3] - self._mean) / self._sigma
        return float(np.minimum(costs, _LARGEST_COST).sum() + pulls @ pulls)

    def _farthest(self, equations: _Equations, damping: float) -> tuple[_State, float]:
        """The state after a step, or twice, four and eight times as far while that lowers the cost."""
        step = self._step(equations, damping)
        moved = self._moved(*step, 1.0)
        cost = self._cost(moved)
        for length in _LENGTHS:
            farther = self._moved(*step, length)
            lower = self._cost(farther)
            if not lower < cost:
                break
            moved, cost = farther, lower
        return moved, cost

    def _step(self, equations: _Equations, damping: float) -> tuple[Floats, Floats]:
        """A step of poses and lens (G,), and how the points follow (T, 3)."""
        information, scores, own, follow = equations.reduced(damping)
        step = np.zeros(len(information))
        information[np.diag_indices(len(information))] *= 1 + damping
        free = self._held(information)
        gradient = scores.sum(axis=0) + equations.pull
        step[free] = -np.linalg.solve(information[np.ix_(free, free)], gradient[free])
        return step, own + follow @ step

    def _moved(self, step: Floats, follow: Floats, length: float) -> _State:
        """The state after a multiple of a step."""
        R, t, X, lens = self._state
        poses = length * step[: self._first].reshape(-1, 6)
        turned = rotation_from_vector(poses[:, :3])
        X = X - length * np.einsum("tab,tb->ta", _tangents(X), follow)
        X[:, 3] = np.maximum(X[:, 3], 0.0)  # beyond infinity is behind the cameras
        X /= np.linalg.norm(X, axis=1)[:, None]
        moved_t = np.einsum("kij,kj->ki", turned, t) + poses[:, 3:]
        return turned @ R, moved_t, X, lens + length * step[self._first :]

    def _held(self, information: Floats) -> Ints:
        """Hold the longest baseline; returns the unknowns without those of the first view."""
        R, t, *_ = self._state
        centres = -np.einsum("kji,kj->ki", R, t)
        held = int(np.argmax(np.linalg.norm(centres - centres[0], axis=1)))
        along = t[held] - R[held] @ R[0].T @ t[0]
        along /= max(float(np.linalg.norm(along)), 1e-300)
        own = slice(6 * held + 3, 6 * held + 6)
        information[own, own] += _GAUGE * max(1.0, float(information[own, own].trace())) * np.outer(along, along)
        return np.arange(6, len(information))

    # -- equations --------------------------------------------------------------------------------------------------

    def _projected(self, state: _State, *, differentiate: bool = True) -> tuple[Floats, Bools, tuple[Floats, ...]]:
        """Pixels (N, 2), which of them are seen (N,), and the derivatives by pose, point and lens."""
        R, t, X, lens = state[0][self._views], state[1][self._views], state[2][self._points], state[3]
        P = np.einsum("nij,nj->ni", R, X[:, :3]) + X[:, 3:] * t
        seen = P[:, 2] > 1e-9
        inverse = 1 / np.where(seen, P[:, 2], 1.0)
        x = P[:, :2] * inverse[:, None]
        r2, focal_px, k1, k2 = np.sum(x * x, axis=1), self._focal_px * math.exp(lens[0]), lens[1], lens[2]
        seen &= (1 + 3 * k1 * r2 + 5 * k2 * r2**2 > _LEAST_GROWTH) & (r2 < _LARGEST_TANGENT**2)
        bent = focal_px * x * (1 + k1 * r2 + k2 * r2**2)[:, None]
        pixels = bent + self._centre + lens[3:]
        if not differentiate:
            return pixels, seen, ()
        by_x = (1 + k1 * r2 + k2 * r2**2)[:, None, None] * np.eye(2)
        by_x = focal_px * (by_x + (2 * k1 + 4 * k2 * r2)[:, None, None] * x[:, :, None] * x[:, None, :])
        by_P = by_x @ (inverse[:, None, None] * np.concatenate([np.tile(np.eye(2), (len(x), 1, 1)), -x[..., None]], 2))
        turning = by_P @ np.cross(np.eye(3)[None], P[:, None, :]).swapaxes(1, 2)
        by_pose = np.concatenate([turning, X[:, 3, None, None] * by_P], axis=2)
        by_point = by_P @ np.concatenate([R, t[:, :, None]], axis=2) @ _tangents(state[2])[self._points]
        curves = focal_px * x[:, :, None] * np.stack([r2, r2**2], axis=1)[:, None, :]
        by_lens = np.concatenate([bent[..., None], curves, np.tile(np.eye(2), (len(x), 1, 1))], axis=2)
        return pixels, seen, (by_pose, by_point, by_lens)

    def _equations(self) -> _Equations:
        """The equations of a step at the current state."""
        pixels, seen, derivatives = self._projected(self._state)
        residuals = (pixels - self._measured) / self.noise_px
        squares = np.sum(residuals**2, axis=1)
        root = np.where(seen, 1 / np.sqrt(1 + squares / CAUCHY**2), 0.0)
        residuals *= root[:, None]
        by_pose, by_point, by_lens = ((root / self.noise_px)[:, None, None] * one for one in derivatives)
        count, size = len(self._state[2]), self._first + _LENS
        lens, poses = slice(self._first, size), 6 * self._views[:, None] + np.arange(6)
        own, block = np.zeros((count, 3)), np.zeros((count, 3, 3))
        coupling, scores = np.zeros((count, 3, size)), np.zeros((count, size))
        self._sum(np.einsum("nka,nkb->nab", by_point, by_point), block)
        self._sum(np.einsum("nka,nk->na", by_point, residuals), own)
        self._sum(np.einsum("nka,nkb->nab", by_point, by_lens), coupling[:, :, lens])
        self._sum(np.einsum("nka,nk->na", by_lens, residuals), scores[:, lens])
        # A view sees a point once.
        scores[self._points[:, None], poses] = np.einsum("nka,nk->na", by_pose, residuals)
        coupling[self._points[:, None], :, poses] = np.einsum("nka,nkb->nba", by_point, by_pose)
        information = np.zeros((size, size))
        products = np.einsum("nka,nkb->nab", by_pose, np.concatenate([by_pose, by_lens], axis=2))[self._by_view]
        for k, of_view in zip(self._of_view[0], np.add.reduceat(products, self._of_view[1], axis=0), strict=True):
            own_pose = slice(6 * k, 6 * k + 6)
            information[own_pose, own_pose], information[own_pose, lens] = of_view[:, :6], of_view[:, 6:]
        information[lens, : self._first] = information[: self._first, lens].T
        prior = np.diag(1 / self._sigma**2)
        information[lens, lens] = np.einsum("nka,nkb->ab", by_lens, by_lens) + prior
        pull = np.zeros(size)
        pull[lens] = prior @ (self._state[3] - self._mean)
        return _Equations(information, pull, scores, block, own, coupling)

    def _sum(self, terms: Floats, of_points: Floats) -> None:
        """Sum terms (N, ...) over the observations of each point (T, ...)."""
        of_points[self._of_point[0]] = np.add.reduceat(terms, self._of_point[1], axis=0)

    # -- the result -------------------------------------------------------------------------------------------------

    def estimate(self) -> LensEstimate:
        """The lens with its deviations."""
        information, scores = self._equations().reduced(0.0)[:2]
        free = self._held(information)
        response = np.linalg.inv(information[np.ix_(free, free)])[-_LENS:]
        moved = scores[:, free] @ response.T
        variances = np.max(
            [np.diag(response[:, -_LENS:]), np.sum(moved**2, axis=0), np.sum((self._regions @ moved) ** 2, axis=0)],
            axis=0,
        )
        log_scale, k1, k2 = self._state[3][:3].tolist()
        pulls = (self._state[3] - self._mean) / self._sigma
        sigmas = _OPTIMISM * np.sqrt(variances * (1 + float(pulls @ pulls) / PULL_FREEDOM))
        return LensEstimate(
            focal_px=self._focal_px * math.exp(log_scale),
            focal_sigma=math.hypot(float(sigmas[0]), _MODEL_SIGMA),
            k1=k1,
            k1_sigma=float(sigmas[1]),
            k2=k2,
            inliers=float(np.mean(self._squares(self._state) < 9.0)),
        )


class _Equations(NamedTuple):
    """The equations of a step, with the unknowns of the points."""

    #: information, pull: (G, G), (G,) Of poses and lens before the points are eliminated; the pull of the prior.
    information: Floats
    pull: Floats
    #: (T, G) The share of each point in the gradient.
    scores: Floats
    #: block, own, coupling: (T, 3, 3), (T, 3), (T, 3, G) Those of the points.
    block: Floats
    own: Floats
    coupling: Floats

    def reduced(self, damping: float) -> tuple[Floats, Floats, Floats, Floats]:
        """The information (G, G) and scores (T, G) of poses and lens with the points eliminated.

        * Returns: Besides how the points move by themselves (T, 3), and how they follow (T, 3, G).
        """
        # A point at infinity has no information about its distance.
        block = self.block * (1 + damping * np.eye(3)) + 1e-9 * np.eye(3)
        inverse = np.asarray(np.linalg.inv(block), np.float64)
        follow, size = inverse @ self.coupling, len(self.pull)
        information = self.information - self.coupling.reshape(-1, size).T @ follow.reshape(-1, size)
        scores = self.scores - np.einsum("tag,ta->tg", follow, self.own)
        return information, scores, np.einsum("tab,tb->ta", inverse, self.own), follow


def _tangents(X: Floats) -> Floats:
    """Orthonormal vectors (T, 4, 3) across unit vectors (T, 4), by a Householder reflection."""
    mirror = X.copy()
    mirror[:, 3] += np.where(X[:, 3] >= 0, 1.0, -1.0)
    mirror /= np.linalg.norm(mirror, axis=1)[:, None]
    return np.asarray((np.eye(4) - 2 * mirror[:, :, None] * mirror[:, None, :])[:, :, :3])
