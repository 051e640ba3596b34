"""What a rotation is, and the functions of quest that the laws of rotations are tested with."""

import inspect
from collections.abc import Callable

import numpy as np

import quest
from tests.benchmarks.quest.solvers import SOLVERS

#: Every function of the package by its name, with the classical solvers that it is compared with.
FUNCTIONS: dict[str, Callable[..., object]] = {
    **{name: getattr(quest, name) for name in quest.__all__ if inspect.isfunction(getattr(quest, name))},
    **{name: solver.function for name, solver in SOLVERS.items()},
}


def is_rotation(R: np.ndarray) -> bool:
    """Whether ``R R^T = 1`` and ``det R = 1`` to 1e-9."""
    orthonormal = np.isfinite(R).all() and np.abs(R @ R.T - np.eye(3)).max() < 1e-9
    return bool(orthonormal and abs(np.linalg.det(R) - 1) < 1e-9)
