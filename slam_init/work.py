"""Long computations in slices: a frame must not wait for a window that is judged.

A camera delivers a frame every 33 ms, and a judgement may take ten times as long. So the judgement runs in slices, one
in each call of :meth:`slam_init.initializer.Initializer.process`. The code of the judgement announces its work by
:func:`spend`, wherever it is in the call stack. Where the share of the frame is used up, the judgement pauses there
until the next frame.

Slices are counted in work and not in seconds. So the same frames give the same results on a slow and on a fast machine.
The unit is a microsecond on one core of the machine that the prices were measured on
(``python -m slam_init.benchmarks.speed``).

greenlet switches between the call stacks in a microsecond. A thread would need locks around all that both sides use,
and generators would turn every function between the initializer and the equations into one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Generic, TypeVar

import greenlet

from slam_init.errors import SlamInitError

__all__ = ["Prices", "Sliced", "seconds", "spend"]

_Value = TypeVar("_Value")


class Prices:
    """What the parts of a judgement take, in microseconds on one core of the machine that they were measured on.

    ``python -m slam_init.benchmarks.speed`` measures them again.
    """

    #: The best pair: fixed, and for each match.
    PAIR, PAIR_MATCH = 7000.0, 18.0
    #: The tracks of a window, for each observation.
    GATHER = 1.7
    #: The rotation between two views; a view that is located by points; points by two views and more.
    ALIGN, LOCATE, TRIANGULATE = 220.0, 1700.0, 3500.0
    #: The cost of a state and its equations: fixed, and for each observation.
    COST, COST_OBSERVATION = 130.0, 0.13
    EQUATIONS, EQUATIONS_OBSERVATION = 500.0, 0.62
    #: The parts of the risk, each for a motion; the uncertainty of a direction for a view.
    LINEARIZE, MARGINALIZE, CHANCE, NEIGHBOURS, DISTANCES, OTHER_MOTION, DIRECTION = (
        400.0, 4000.0, 400.0, 4500.0, 2700.0, 1500.0, 650.0,
    )  # fmt: skip
    #: Bundle adjustment, for each observation: the points alone, a factor of the graph, an iteration.
    POINTS, GRAPH, ITERATION = 3.5, 3.5, 4.5
    #: The covariance of a pose; the map that is handed over.
    COVARIANCE, MAP = 400.0, 1500.0


class _Stack(greenlet.greenlet):
    """The call stack of a computation that runs in slices."""

    left: float = 0.0
    """What is left of the slice."""
    fresh: bool = False
    """Whether nothing was spent of it."""
    paused_s: float = 0.0
    """Seconds that the computation has been paused."""


class Sliced(Generic[_Value]):
    """A computation that runs in slices.

    Parameters
    ----------
    compute : callable
        Takes nothing. It may call :func:`spend` at any depth.
    """

    def __init__(self, compute: Callable[[], _Value]) -> None:
        self._values: list[_Value] = []
        self._stack = _Stack(lambda: self._values.append(compute()))

    @property
    def done(self) -> bool:
        """Whether the computation has ended.

        Returns
        -------
        bool
        """
        return self._stack.dead

    @property
    def value(self) -> _Value:
        """The result of a computation that has ended.

        Returns
        -------
        object
            What ``compute`` returned.
        """
        return self._values[0]

    def run(self, work: float) -> None:
        """Run a slice.

        Parameters
        ----------
        work : float
            What the slice may spend; infinite to run to the end. Work that cannot be divided may exceed a slice: the
            next ones are shorter then.

        Raises
        ------
        SlamInitError
            In another thread than that of the first slice.
        """
        stack = self._stack
        stack.left, stack.fresh = min(stack.left, 0.0) + work, True
        if stack.left > 0 and not stack.dead:
            try:
                stack.parent = greenlet.getcurrent()
            except ValueError:  # greenlet's word for another thread
                raise SlamInitError(
                    "a frame came from another thread while a window was judged: process all frames in one thread, or "
                    "set Config(work_per_frame=None)"
                ) from None
            stack.switch()


def spend(work: float) -> None:
    """Announce work that follows. Outside of a :class:`Sliced` computation this does nothing.

    Parameters
    ----------
    work : float
        In microseconds on one core of the machine that the prices were measured on. Work that does not fit into what is
        left of a slice waits for the next slice.
    """
    stack = greenlet.getcurrent()
    if not isinstance(stack, _Stack):
        return
    while stack.left < work and not (stack.fresh and stack.left > 0):
        parent, paused = stack.parent, time.perf_counter()
        if parent is None:
            break
        parent.switch()
        stack.paused_s += time.perf_counter() - paused
    stack.left -= work
    stack.fresh = False


def seconds() -> float:
    """A clock that stands still while a sliced computation is paused.

    Returns
    -------
    float
        Differences have a meaning within one computation.
    """
    stack = greenlet.getcurrent()
    return time.perf_counter() - (stack.paused_s if isinstance(stack, _Stack) else 0.0)
