"""Linear algebra of small matrices on one thread, and standard deviations with a check of the covariance."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

#: A variance may be negative by this share of the largest one: by the rounding of an inverse whose condition is 1e13.
_ROUNDING = 1e-3


def deviations(variances: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Standard deviations of the last axis of variances, which rounding may have made a little negative.

    Raises numpy.linalg.LinAlgError where one is NaN or negative by more: the matrix was no covariance, and a
    standard deviation of zero would state certainty.
    """
    largest = variances.max(axis=-1, keepdims=True, initial=-np.inf)
    if not ((largest >= 0).all() and (variances >= -_ROUNDING * largest).all()):
        raise np.linalg.LinAlgError("a covariance is not positive definite")
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)), np.float64)


@cache
def _controller() -> ThreadpoolController:
    # It looks for the libraries of the process, which takes some milliseconds: once is enough.
    return ThreadpoolController()


def single_threaded() -> AbstractContextManager[object]:
    """Limit the linear algebra library of numpy to one thread.

    With matrices of some hundred rows, several threads wait for each other longer than they compute: on two busy cores
    the elimination of the tracks took 5.6 ms with two threads, and 0.3 ms with one. One core is also what the
    initializer is meant to need.
    """
    limited: AbstractContextManager[object] = _controller().limit(limits=1, user_api="blas")
    return limited
