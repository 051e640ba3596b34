"""Common parts of the scene builders: random draws, the camera, and the motion of a hand-held camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sequences_synth.hand_motion import Handling
from sequences_synth.textured_quad import Painter
from sequences_synth.trajectory import Jitter

__all__ = ["Setup", "curved_path", "hand_jitter", "linear_angles"]

Floats = NDArray[np.float64]

# A hand trembles by a fraction of a degree and some millimetres.
HAND_DEG, _HAND_M = 0.25, 0.004


@dataclass(frozen=True, eq=False)
class Setup:
    """Input of every scene builder: the random generator and the camera.

    Attributes
    ----------
    rng : numpy.random.Generator
        Source of all draws of the scene.
    seed : tuple of int
        Entropy of the scene, from which the textures are seeded.
    K : (3, 3) float
        True calibration matrix, pixels.
    width, height : int
        Image size in pixels.
    slow_start : float
        Number of frames over which the motion rises to full speed, see :func:`sequences_synth.trajectory.progress`.
    fps : float
        Frames per second, for scenes whose motion is in seconds.
    handling : Handling
        How the camera of these scenes is handled.
    """

    rng: np.random.Generator
    seed: tuple[int, ...]
    K: Floats
    width: int
    height: int
    slow_start: float
    fps: float
    handling: Handling

    def painter(self, viewpoint: Floats, nearest_m: float) -> Painter:
        """Make a painter whose textures suit this camera.

        Parameters
        ----------
        viewpoint : (3,) float
            Approximate position of the camera in the world, metres.
        nearest_m : float
            Least distance between the camera and any surface, metres.

        Returns
        -------
        Painter
        """
        return Painter(self.seed, float(self.K[0, 0]), viewpoint, nearest_m)

    def random_sign(self) -> float:
        """Draw a sign.

        Returns
        -------
        float
            Either -1 or 1.
        """
        return float(self.rng.choice([-1.0, 1.0]))


def curved_path(start: Floats, along: Floats, bend: Floats) -> Callable[[float], Floats]:
    """Make a path that is quadratic in the progress p: ``start + p along + p^2 bend``.

    Parameters
    ----------
    start, along, bend : (3,) float
        World frame, metres.

    Returns
    -------
    callable
        Progress -> camera centre (3,).
    """
    return lambda p: start + p * along + p * p * bend


def linear_angles(start: Floats, by: Floats) -> Callable[[float], tuple[float, float, float]]:
    """Make angles that are linear in the progress p: ``start + p by``.

    Parameters
    ----------
    start, by : (3,) float
        Yaw, pitch and roll in radians.

    Returns
    -------
    callable
        Progress -> yaw, pitch, roll in radians.
    """
    return lambda p: _yaw_pitch_roll(start + p * by)


def _yaw_pitch_roll(angles: Floats) -> tuple[float, float, float]:
    yaw, pitch, roll = angles.tolist()
    return yaw, pitch, roll


def hand_jitter(setup: Setup, distance_m: float) -> Jitter:
    """Draw the tremor of a hand. The position trembles less when the scene is near, as people then move with care.

    Parameters
    ----------
    setup : Setup
    distance_m : float
        Distance to the scene in metres; below 2 m the tremor of the position shrinks in proportion.

    Returns
    -------
    Jitter
    """
    return Jitter.draw(setup.rng, HAND_DEG, _HAND_M * min(1.0, distance_m / 2))
