"""What every scene is built from: the draw, the camera, and paths of hands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sequences_synth.textured_quad import Painter
from sequences_synth.trajectory import Jitter

__all__ = ["Setup", "hand", "sweep", "turning"]

Floats = NDArray[np.float64]

# Hands tremble by a fraction of a degree and some millimetres.
HAND_DEG, _HAND_M = 0.25, 0.004


@dataclass(frozen=True, eq=False)
class Setup:
    """What every builder gets: its random draws and the camera that will look."""

    rng: np.random.Generator
    seed: tuple[int, ...]
    K: Floats
    width: int
    height: int
    slow_start: float

    def painter(self, viewpoint: Floats, nearest_m: float) -> Painter:
        """Someone to paint this world, to be seen from a viewpoint (3,), never nearer than ``nearest_m``."""
        return Painter(self.seed, float(self.K[0, 0]), viewpoint, nearest_m)

    def sign(self) -> float:
        """-1 or 1."""
        return float(self.rng.choice([-1.0, 1.0]))


def sweep(start: Floats, along: Floats, bend: Floats) -> Callable[[float], Floats]:
    """A curved path: ``start + p along + p^2 bend`` at progress p."""
    return lambda p: start + p * along + p * p * bend


def turning(start: Floats, by: Floats) -> Callable[[float], tuple[float, float, float]]:
    """Angles that change evenly: yaw, pitch, roll in radians."""

    def angles(p: float) -> tuple[float, float, float]:
        yaw, pitch, roll = (start + p * by).tolist()
        return yaw, pitch, roll

    return angles


def hand(setup: Setup, distance_m: float) -> Jitter:
    """Draw the tremor of a hand; who looks at something near holds the camera stiller."""
    return Jitter.draw(setup.rng, HAND_DEG, _HAND_M * min(1.0, distance_m / 2))
