"""The relative pose as a problem for RANSAC: the motions of a sample, and the cost of a motion on all matches.

Models are rows (q_wxyz, t) of seven numbers, ``cam2_from_cam1``, |t| = 1; data are matches of unit bearings.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import matrix_from_quaternion, quaternion_from_matrix
from quest.geometry.refine import refine_pose
from quest.solvers.quest6 import quest6
from quest.solvers.quest7 import quest7
from quest.solvers.selection import select_candidates

__all__ = ["SAMPLERS", "CompiledPoseProblem", "RelativePoseProblem", "Sampler"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Sampler(NamedTuple):
    """A solver that proposes motions, and the number of matches that it takes.

    Attributes
    ----------
    size : int
        Number of matches in a sample.
    candidates : callable
        ``candidates(m, n)``: quaternions (B, K, 4) of samples (B, size, 3).
    """

    size: int
    candidates: Callable[[Floats, Floats], Floats]


#: The solvers that :func:`quest.robust.ransac.ransac` may run. QuEst 6 solves one of its three eigenproblems: the other
#: two triple its time and save less than that in samples. Its compiled counterpart is
#: :func:`quest.robust.kernels.six_point.solve_six`.
SAMPLERS = {
    "quest6": Sampler(6, lambda m, n: quest6(m, n, lambdas="x")),
    "quest7": Sampler(7, quest7),
}


class RelativePoseProblem:
    """Matched bearings as a :class:`quest.robust.ransac.Problem`.

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings in camera 1 and camera 2.
    threshold_rad : float
        Sampson error above which a match is an outlier.
    solver : str
        A key of :data:`SAMPLERS`.
    """

    def __init__(self, m: Floats, n: Floats, threshold_rad: float, solver: str = "quest6") -> None:
        self.m, self.n, self.threshold_rad = m, n, threshold_rad
        self._sampler = SAMPLERS[solver]
        self.sample_size = self._sampler.size

    def __len__(self) -> int:
        return len(self.m)

    def solve(self, samples: Ints) -> Floats:
        """The models that samples propose: the best four candidates of each sample.

        Parameters
        ----------
        samples : (B, sample_size) int
            Indices of matches.

        Returns
        -------
        (H, 7) float
        """
        m, n = self.m[samples], self.n[samples]
        q, t = select_candidates(self._sampler.candidates(m, n), m, n)
        models = np.concatenate([q, t], axis=-1).reshape(-1, 7)
        return np.asarray(models[np.isfinite(models).all(axis=1)])

    def residuals(self, models: Floats) -> tuple[Floats, Bools]:
        """Residuals of all matches under each model.

        Parameters
        ----------
        models : (H, 7) float
            Motions (q_wxyz, t).

        Returns
        -------
        r2 : (H, N) float
            Squared Sampson errors, rad^2.
        behind : (H, N) bool
            Whether a match lies behind a camera beyond doubt.
        """
        R = matrix_from_quaternion(models[:, :4])
        t = models[:, 4:]
        zero = np.zeros(len(t))
        tx = np.stack(
            [
                np.stack([zero, -t[:, 2], t[:, 1]], axis=1),
                np.stack([t[:, 2], zero, -t[:, 0]], axis=1),
                np.stack([-t[:, 1], t[:, 0], zero], axis=1),
            ],
            axis=1,
        )
        # The products n_a m_b of every match: n . E m and n . R m of all hypotheses are then two matrix products.
        outer = (self.n[:, :, None] * self.m[:, None, :]).reshape(-1, 9).T
        e = (tx @ R).reshape(-1, 9) @ outer
        c = R.reshape(-1, 9) @ outer  # cosine of the parallax
        p = np.einsum("hi,hij->hj", t, R) @ self.m.T  # t . R m
        s = t @ self.n.T
        e2 = e * e
        r2 = e2 / np.maximum(2 - p * p - s * s - 2 * e2, 1e-12)
        # The depths have the signs of c s - p and s - c p. A parallax below the noise leaves these signs open: the
        # angle between two noisy rays of a distant point has sqrt(2) times the standard deviation of one ray.
        observable = 1 - c * c > 2 * self.threshold_rad**2
        behind = observable & ((c * s < p) | (s < c * p))
        return r2, behind

    def costs(self, models: Floats) -> tuple[Floats, Ints]:
        """Truncated sums of squared Sampson errors, and numbers of inliers.

        Parameters
        ----------
        models : (H, 7) float
            Motions (q_wxyz, t).

        Returns
        -------
        costs : (H,) float
            The sums, rad^2.
        inliers : (H,) int
            Number of inliers of each model.
        """
        r2, behind = self.residuals(models)
        limit = self.threshold_rad**2
        r2[behind] = limit
        return np.minimum(r2, limit).sum(axis=1), (r2 < limit).sum(axis=1)

    def explained(self, model: Floats, gate_rad: float) -> Bools:
        """Whether each match lies within the gate and in front of both cameras.

        Parameters
        ----------
        model : (7,) float
            A motion (q_wxyz, t).
        gate_rad : float
            Largest Sampson error.

        Returns
        -------
        (N,) bool
        """
        r2, behind = self.residuals(model[None])
        return np.asarray((r2[0] < gate_rad**2) & ~behind[0])

    def polish(self, model: Floats) -> Floats:
        """Refine a model on the matches near it.

        Parameters
        ----------
        model : (7,) float
            A motion (q_wxyz, t).

        Returns
        -------
        (7,) float
            The model as it came where fewer than six matches are near.
        """
        r2, behind = self.residuals(model[None])
        # Twice the threshold: a model from six noisy matches misses many of its own inliers by a little.
        near = (r2[0] < (2 * self.threshold_rad) ** 2) & ~behind[0]
        return self.refine(model, near, 0.5 * self.threshold_rad) if near.sum() >= 6 else model

    def refine(self, model: Floats, use: Bools, scale_rad: float) -> Floats:
        """Refine a model on given matches, see :func:`quest.geometry.refine.refine_pose`.

        Parameters
        ----------
        model : (7,) float
            A motion (q_wxyz, t).
        use : (N,) bool
            The matches to refine on.
        scale_rad : float
            Scale of the Geman-McClure kernel.

        Returns
        -------
        (7,) float
        """
        R, t = refine_pose(matrix_from_quaternion(model[:4]), model[4:], self.m[use], self.n[use], scale_rad)
        return np.concatenate([quaternion_from_matrix(R), t])


class CompiledPoseProblem(RelativePoseProblem):
    """The same problem with the compiled loops of :mod:`quest.robust.kernels`; faster for a few models.

    Parameters
    ----------
    m, n : (N, 3) float
        Unit bearings in camera 1 and camera 2.
    threshold_rad : float
        Sampson error above which a match is an outlier.
    """

    def __init__(self, m: Floats, n: Floats, threshold_rad: float) -> None:
        super().__init__(np.ascontiguousarray(m), np.ascontiguousarray(n), threshold_rad)

    def residuals(self, models: Floats) -> tuple[Floats, Bools]:
        """Residuals of all matches under each model.

        Parameters
        ----------
        models : (H, 7) float
            Motions (q_wxyz, t).

        Returns
        -------
        r2 : (H, N) float
            Squared Sampson errors, rad^2.
        behind : (H, N) bool
            Whether a match lies behind a camera beyond doubt.
        """
        from quest.robust import kernels

        each = [kernels.residuals_of_model(self.m, self.n, model, self.threshold_rad) for model in models]
        return np.array([r2 for r2, _ in each]), np.array([behind for _, behind in each])

    def explained(self, model: Floats, gate_rad: float) -> Bools:
        """Whether each match lies within the gate and in front of both cameras.

        Parameters
        ----------
        model : (7,) float
            A motion (q_wxyz, t).
        gate_rad : float
            Largest Sampson error.

        Returns
        -------
        (N,) bool
        """
        from quest.robust import kernels

        r2, behind = kernels.residuals_of_model(self.m, self.n, model, self.threshold_rad)
        return np.asarray((r2 < gate_rad**2) & ~behind)

    def refine(self, model: Floats, use: Bools, scale_rad: float) -> Floats:
        """Refine a model on given matches, see :func:`quest.geometry.refine.refine_pose`.

        Parameters
        ----------
        model : (7,) float
            A motion (q_wxyz, t).
        use : (N,) bool
            The matches to refine on.
        scale_rad : float
            Scale of the Geman-McClure kernel.

        Returns
        -------
        (7,) float
        """
        from quest.robust import kernels

        R, t = kernels.rotation_of_model(model), model[4:].copy()
        kernels.refine(self.m, self.n, use, R, t, scale_rad, 12)
        return kernels.model_of_pose(R, t)
