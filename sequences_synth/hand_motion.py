"""Motion of a camera in a hand, in seconds: turning about an axis that changes, and translation along an arc.

The rotation vector of the camera is a sum of two sines for each axis. The amplitudes are scaled such that the angular
speed has the requested root mean square over the duration of the sequence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sequences_synth.trajectory import rotations_from_vectors

Floats = NDArray[np.float64]

# A person who looks around with a camera swings it in one to three seconds, the wrist a little faster.
_HERTZ = np.array([0.4, 0.8])
_SIZES = np.array([1.0, 0.5])
# Instants per second at which the speed is measured: the fastest sine has 30 of them in a period.
_RATE_HZ = 60.0
_SCALINGS = 12
# A rotation vector of more than 2 rad comes near half a turn, where the speed no longer grows with its amplitude.
_LARGEST_RAD = 2.0
# The path bends by this much in a second, radians.
_BEND_RAD_S = (0.2, 0.8)


@dataclass(frozen=True)
class Handling:
    """How a camera is handled."""

    #: Time from the first to the last frame.
    duration_s: float
    #: Root mean square of the angular speed over this time.
    turning_deg_s: float
    #: Speed of the translation, median depths per second.
    speed: float


@dataclass(frozen=True, eq=False)
class HandTurning:
    """Hand-held turning: a rotation vector whose axes each have two sines."""

    #: sizes_rad, rates_rad_s, phases_rad: (3, 2) Amplitude, angular frequency and phase, axis by sine.
    sizes_rad: Floats
    rates_rad_s: Floats
    phases_rad: Floats

    @staticmethod
    def draw(rng: np.random.Generator, handling: Handling, largest_tilt_deg: float = np.inf) -> HandTurning:
        """Draw a turning with the requested angular speed.

        * ``largest_tilt_deg``: The optical axis stays within about this angle of that without turning. The hand then
          trembles faster.
        """
        rates = 2 * np.pi * _HERTZ * rng.uniform(0.8, 1.25, (3, 2))
        sizes = _SIZES * rng.uniform(0.7, 1.0, (3, 2))
        phases = rng.uniform(0, 2 * np.pi, (3, 2))
        turning = HandTurning(sizes, rates, phases)
        if handling.turning_deg_s == 0.0:
            return replace(turning, sizes_rad=0 * sizes)
        # Faster sines have the same speed at a smaller amplitude: the rates grow until both bounds hold.
        while True:
            turning = turning._at_speed(handling)
            vectors = turning.rotation_vector(handling.duration_s * np.linspace(0, 1, 200))
            tilt_deg = float(np.degrees(np.linalg.norm(vectors[:, :2], axis=1).max()))
            total_rad = float(np.linalg.norm(vectors, axis=1).max())
            if tilt_deg <= largest_tilt_deg and total_rad <= _LARGEST_RAD:
                return turning
            turning = replace(turning, rates_rad_s=1.2 * turning.rates_rad_s, sizes_rad=sizes)

    def rotation_vector(self, time_s: Floats) -> Floats:
        """Compute the rotation vector of the camera.

        Shapes: returns (..., 3).
        """
        angles = self.phases_rad + self.rates_rad_s * np.asarray(time_s)[..., None, None]
        return np.asarray(np.sum(self.sizes_rad * np.sin(angles), axis=-1))

    def speed_deg_s(self, duration_s: float) -> float:
        """Compute the angular speed."""
        rate_hz = _RATE_HZ * float(np.max(self.rates_rad_s)) / (2 * np.pi * _HERTZ[-1])
        R = rotations_from_vectors(
            self.rotation_vector(np.linspace(0, duration_s, 2 + int(np.ceil(rate_hz * duration_s))))
        )
        # The chord of a small rotation: |A - B| = 2 sqrt(2) sin(angle / 2).
        chords = np.linalg.norm(np.diff(R, axis=0), axis=(1, 2))
        steps_rad = 2 * np.arcsin(np.minimum(chords / np.sqrt(8), 1.0))
        return float(np.degrees(np.sqrt(np.mean(steps_rad**2)) * len(steps_rad) / duration_s))

    def _at_speed(self, handling: Handling) -> HandTurning:
        """The same turning, with the amplitudes scaled to the requested speed."""
        turning = self
        for _ in range(_SCALINGS):
            factor = handling.turning_deg_s / turning.speed_deg_s(handling.duration_s)
            turning = replace(turning, sizes_rad=turning.sizes_rad * factor)
            if np.abs(turning.rotation_vector(np.zeros(1))).max() > 10 * _LARGEST_RAD:
                break
        return turning


@dataclass(frozen=True, eq=False)
class Arc:
    """An arc of a circle that is travelled at a constant speed."""

    #: Median depths per second; exactly no translation where it is 0.
    speed: float
    #: Angular velocity of the direction of motion.
    bend_rad_s: float
    #: along, across: (3,) Orthonormal: direction of the first velocity, and direction to which the path bends.
    along: Floats
    across: Floats

    @staticmethod
    def draw(rng: np.random.Generator, handling: Handling, along: Floats, across: Floats) -> Arc:
        """Draw the bend of an arc.

        Shapes: ``along, across`` (3,).
        """
        return Arc(handling.speed, float(rng.uniform(*_BEND_RAD_S)), along, across)

    def position(self, time_s: Floats) -> Floats:
        """Compute the camera centre.

        Shapes: returns (..., 3).
        """
        angle = self.bend_rad_s * np.asarray(time_s)[..., None]
        radius = self.speed / self.bend_rad_s
        return np.asarray(radius * (np.sin(angle) * self.along + (1 - np.cos(angle)) * self.across))
