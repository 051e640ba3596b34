"""Long computations in slices: a frame must not wait for a window that is judged.

A camera delivers a frame every 33 ms, and a judgement may take ten times as long. So the judgement runs in slices, one
in each call of :meth:`slam_init.initializer.Initializer.process`. The code of the judgement announces its work by
:func:`spend`, wherever it is in the call stack. Where the share of the frame is used up, the judgement pauses there
until the next frame.

Slices are counted in work and not in seconds. So the same frames give the same results on a slow and on a fast machine.
The unit is a microsecond on one core of the machine that the prices were measured on
(``python -m tests.benchmarks.speed``).

greenlet switches between the call stacks in a microsecond. A thread would need locks around all that both sides use,
and generators would turn every function between the initializer and the equations into one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Generic, TypeVar

import greenlet

from slam_init.errors import SlamInitError

_Value = TypeVar("_Value")


class Prices:
    """What the parts of a judgement take, in microseconds on one core of the machine that they were measured on.

    ``python -m tests.benchmarks.speed`` measures them again.
    """

    #: The best pair: fixed, and for each match.
    PAIR, PAIR_MATCH = 1500.0, 3.0
    #: The tracks of a window: for each observation, and for each view. Rays that are corrected for another readout.
    GATHER, GATHER_VIEW, CORRECTION = 0.1, 300.0, 0.1
    #: The rotation between two views; a view that is located by points, and the poses that are drawn where a guess does
    #: not suffice; points by two views and more: fixed, and for each ray.
    ALIGN, LOCATE, DRAW, TRIANGULATE, TRIANGULATE_RAY = 110.0, 180.0, 1300.0, 450.0, 0.6
    #: The cost of a state and its equations, with the step that follows: fixed, and for each observation; with error
    #: fields in all views for each observation.
    COST, COST_OBSERVATION = 40.0, 0.05
    EQUATIONS, EQUATIONS_OBSERVATION, EQUATIONS_FIELDS = 110.0, 0.24, 1.3
    #: The expansion of a fit about its equations: fixed, and for each view. The fields integrated out: fixed, and for
    #: each pair of views.
    LINEARIZE, LINEARIZE_VIEW, MARGINALIZE, MARGINALIZE_VIEWS = 40.0, 11.0, 350.0, 14.0
    #: The other parts of the risk, each for a motion; the uncertainty of a direction for a view.
    CHANCE, NEIGHBOURS, DISTANCES, ROTATION, DIRECTION = 150.0, 550.0, 600.0, 700.0, 150.0
    #: What a judgement says besides its risk.
    EVIDENCE = 600.0
    #: Bundle adjustment, for each observation: the table of the tracks, the points alone, residuals and outliers, a
    #: virtual camera, the equations.
    TABLE, POINTS, RESIDUALS, LENS, MAP_EQUATIONS = 0.1, 0.35, 0.5, 0.5, 0.07
    #: Its error: fixed, and for each observation. Its step: fixed, and for each point and pair of views.
    MAP_ERROR, MAP_ERROR_OBSERVATION, MAP_STEP, MAP_ELIMINATION = 60.0, 0.02, 380.0, 0.012
    #: gtsam, for each observation: a factor of the graph, an iteration. The covariance of a pose.
    GRAPH, ITERATION, COVARIANCE = 1.3, 3.0, 400.0
    #: Covariances of the points, for each point and pair of views. The next view located by the points, for each point.
    MAP_COVARIANCES, LOCATE = 0.04, 2.0
    #: The map that is handed over.
    MAP = 900.0


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

    * ``compute``: Takes nothing. It may call :func:`spend` at any depth.
    """

    def __init__(self, compute: Callable[[], _Value]) -> None:
        self._values: list[_Value] = []
        self._stack = _Stack(lambda: self._values.append(compute()))

    @property
    def done(self) -> bool:
        """Whether the computation has ended."""
        return self._stack.dead

    @property
    def value(self) -> _Value:
        """The result of a computation that has ended."""
        return self._values[0]

    def run(self, work: float) -> None:
        """Run a slice.

        * ``work``: What the slice may spend; infinite to run to the end. Work that cannot be divided may exceed a
          slice: the next ones are shorter then.
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

    * ``work``: In microseconds on one core of the machine that the prices were measured on. Work that does not fit into
      what is left of a slice waits for the next slice.
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
    """A clock that stands still while a sliced computation is paused."""
    stack = greenlet.getcurrent()
    return time.perf_counter() - (stack.paused_s if isinstance(stack, _Stack) else 0.0)
