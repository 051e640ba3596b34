"""The relative pose as a problem for RANSAC: which motions a sample proposes, and what each costs on all matches.

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
    """Which solver proposes motions, and from how many matches."""

    size: int
    candidates: Callable[[Floats, Floats], Floats]


#: The solvers that may drive :func:`quest.robust.ransac.ransac`. QuEst 6 with one of its three eigenproblems: the other two
#: triple its time and win less than that in samples.
SAMPLERS = {
    "quest6": Sampler(6, lambda m, n: quest6(m, n, lambdas="x")),
    "quest7": Sampler(7, quest7),
}


class RelativePoseProblem:
    """Matched unit bearings (N, 3), asked what :func:`quest.robust.ransac.ransac` asks, and which matches a model explains.

    ``threshold_rad`` is the Sampson error from which on a match counts as an outlier, ``solver`` one of ``SAMPLERS``.
    """

    def __init__(self, m: Floats, n: Floats, threshold_rad: float, solver: str = "quest6") -> None:
        self.m, self.n, self.threshold_rad = m, n, threshold_rad
        self._sampler = SAMPLERS[solver]
        self.sample_size = self._sampler.size

    def __len__(self) -> int:
        return len(self.m)

    def solve(self, samples: Ints) -> Floats:
        """Models (H, 7) of samples (B, sample_size): the best four candidates of each."""
        m, n = self.m[samples], self.n[samples]
        q, t = select_candidates(self._sampler.candidates(m, n), m, n)
        models = np.concatenate([q, t], axis=-1).reshape(-1, 7)
        return np.asarray(models[np.isfinite(models).all(axis=1)])

    def residuals(self, models: Floats) -> tuple[Floats, Bools]:
        """Squared Sampson errors (H, N) in rad^2, and where a match lies behind a camera beyond doubt (H, N)."""
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
        # n_a m_b of every match, so that n . E m and n . R m of all hypotheses are two matrix products.
        outer = (self.n[:, :, None] * self.m[:, None, :]).reshape(-1, 9).T
        e = (tx @ R).reshape(-1, 9) @ outer
        c = R.reshape(-1, 9) @ outer  # cosine of the parallax
        p = np.einsum("hi,hij->hj", t, R) @ self.m.T  # t . R m
        s = t @ self.n.T
        e2 = e * e
        r2 = e2 / np.maximum(2 - p * p - s * s - 2 * e2, 1e-12)
        # The depths have the signs of c s - p and s - c p. A parallax below the noise says nothing about them: the
        # angle between two noisy rays of a distant point has the standard deviation sqrt(2) times that of one.
        observable = 1 - c * c > 2 * self.threshold_rad**2
        behind = observable & ((c * s < p) | (s < c * p))
        return r2, behind

    def costs(self, models: Floats) -> tuple[Floats, Ints]:
        """Truncated sums of squared Sampson errors (H,) in rad^2, and numbers of inliers (H,)."""
        r2, behind = self.residuals(models)
        limit = self.threshold_rad**2
        r2[behind] = limit
        return np.minimum(r2, limit).sum(axis=1), (r2 < limit).sum(axis=1)

    def explained(self, model: Floats, gate_rad: float) -> Bools:
        """Which matches (N,) lie within the gate and in front of both cameras."""
        r2, behind = self.residuals(model[None])
        return np.asarray((r2[0] < gate_rad**2) & ~behind[0])

    def polish(self, model: Floats) -> Floats:
        """The model refined on the matches near it."""
        r2, behind = self.residuals(model[None])
        # Twice the gate: a model from six noisy matches misses many of its own inliers by a little.
        near = (r2[0] < (2 * self.threshold_rad) ** 2) & ~behind[0]
        return self.refine(model, near, 0.5 * self.threshold_rad) if near.sum() >= 6 else model

    def refine(self, model: Floats, use: Bools, scale_rad: float) -> Floats:
        """The model refined on the matches to use (N,), see :func:`quest.geometry.refine.refine_pose`."""
        R, t = refine_pose(matrix_from_quaternion(model[:4]), model[4:], self.m[use], self.n[use], scale_rad)
        return np.concatenate([quaternion_from_matrix(R), t])


class CompiledPoseProblem(RelativePoseProblem):
    """The same answers about a few models, from the compiled loops of :mod:`quest.robust.kernels`."""

    def __init__(self, m: Floats, n: Floats, threshold_rad: float) -> None:
        super().__init__(np.ascontiguousarray(m), np.ascontiguousarray(n), threshold_rad)

    def residuals(self, models: Floats) -> tuple[Floats, Bools]:
        """See the base class."""
        from quest.robust import kernels

        each = [kernels.residuals_of_model(self.m, self.n, model, self.threshold_rad) for model in models]
        return np.array([r2 for r2, _ in each]), np.array([behind for _, behind in each])

    def explained(self, model: Floats, gate_rad: float) -> Bools:
        """See the base class."""
        from quest.robust import kernels

        r2, behind = kernels.residuals_of_model(self.m, self.n, model, self.threshold_rad)
        return np.asarray((r2 < gate_rad**2) & ~behind)

    def refine(self, model: Floats, use: Bools, scale_rad: float) -> Floats:
        """See the base class."""
        from quest.robust import kernels

        pose = kernels.refine_model(self.m, self.n, use, model, scale_rad, 12)
        return np.concatenate([quaternion_from_matrix(pose[:9].reshape(3, 3)), pose[9:]])
