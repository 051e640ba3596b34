"""Common parts of the scene builders: random draws, the camera, and the motion of a hand-held camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.textured_quad import Painter
from sequences_synth.trajectory import Handling, Jitter

# A hand trembles by a fraction of a degree and some millimetres.
HAND_DEG, _HAND_M = 0.25, 0.004


@dataclass(frozen=True, eq=False)
class Setup:
    """Input of every scene builder: the random generator and the camera."""

    #: Source of all draws of the scene.
    rng: np.random.Generator
    #: Entropy of the scene, from which the textures are seeded.
    seed: tuple[int, ...]
    #: (3, 3) True calibration matrix, pixels.
    K: Floats
    #: width, height: Image size in pixels.
    width: int
    height: int
    #: Number of frames over which the motion rises to full speed, see :func:`sequences_synth.trajectory.progress`.
    slow_start: float
    #: Frames per second, for scenes whose motion is in seconds.
    fps: float
    #: How the camera of these scenes is handled.
    handling: Handling

    def painter(self, viewpoint: Floats, nearest_m: float) -> Painter:
        """Make a painter whose textures suit this camera.

        Shapes: ``viewpoint`` (3,).
        """
        return Painter(self.seed, float(self.K[0, 0]), viewpoint, nearest_m)

    def random_sign(self) -> float:
        """Draw a sign."""
        return float(self.rng.choice([-1.0, 1.0]))


def curved_path(start: Floats, along: Floats, bend: Floats) -> Callable[[float], Floats]:
    """Make a path that is quadratic in the progress p: ``start + p along + p^2 bend``.

    Shapes: ``start, along, bend`` (3,).
    """
    return lambda p: start + p * along + p * p * bend


def linear_angles(start: Floats, by: Floats) -> Callable[[float], tuple[float, float, float]]:
    """Make angles that are linear in the progress p: ``start + p by``.

    Shapes: ``start, by`` (3,).
    """
    return lambda p: _yaw_pitch_roll(start + p * by)


def _yaw_pitch_roll(angles: Floats) -> tuple[float, float, float]:
    yaw, pitch, roll = angles.tolist()
    return yaw, pitch, roll


def hand_jitter(setup: Setup, distance_m: float) -> Jitter:
    """Draw the tremor of a hand. The position trembles less when the scene is near, as people then move with care.

    * ``distance_m``: Distance to the scene in metres; below 2 m the tremor of the position shrinks in proportion.
    """
    return Jitter.draw(setup.rng, HAND_DEG, _HAND_M * min(1.0, distance_m / 2))
