"""Smooth camera paths: where a hand, a drone or a tripod carries the camera.

World frames are z up; camera frames are optical (x right, y down, z forward). A path answers for every
real-valued frame number, so that motion blur can look between the frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["PROGRESS_RANGE", "Jitter", "Path", "orientation", "progress", "rotation_from_vector"]

Floats = NDArray[np.float64]

# A path is laid out for 100 frames: progress runs from 0 to about 1 in them.
_FRAMES = 100.0
# Longer sequences turn back instead of leaving the scene: progress is a sine whose slope is nearly 1 over the
# first 100 frames, and these are the values that it can ever take.
_PHASE = 0.5
PROGRESS_RANGE = (float(np.sin(_PHASE)) - 1.0, float(np.sin(_PHASE)) + 1.0)


def progress(frame: float, slow_start: float) -> float:
    """How far along its path the camera is at a (real-valued) frame: 0 at frame 0, about 1 at frame 100.

    Parameters
    ----------
    frame : float
        Frame number; the camera rests before 0.
    slow_start : float
        Number of frames over which the speed rises smoothly from nothing.
    """
    if frame <= 0:
        return 0.0
    if frame < slow_start:
        # Integral of the smoothstep 3 x^2 - 2 x^3, in frames.
        x = frame / slow_start
        covered = slow_start * (x**3 - 0.5 * x**4)
    else:
        covered = frame - 0.5 * slow_start
    return float(np.sin(covered / _FRAMES - _PHASE) + np.sin(_PHASE))


def orientation(yaw_rad: float, pitch_rad: float, roll_rad: float = 0.0) -> Floats:
    """(3, 3) world_from_cam rotation: zero looks along world y, yaw turns left, pitch looks up."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    yaw = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    pitch = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    level = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # x right, y down = -z, z forward = y
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    roll = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return np.asarray(yaw @ pitch @ level @ roll)


@dataclass(frozen=True, eq=False)
class Jitter:
    """The tremor of a hand: three slow sines an axis.

    Attributes
    ----------
    angles_rad, offsets_m : (3, 3) float
        Amplitudes, axis by sine.
    rates_rad : (3, 3) float
        Phase advance a frame.
    phases_rad : (3, 3) float
    """

    angles_rad: Floats
    offsets_m: Floats
    rates_rad: Floats
    phases_rad: Floats

    @staticmethod
    def draw(rng: np.random.Generator, angle_deg: float, offset_m: float) -> Jitter:
        """Draw a tremor of about the given size, 0.6 to 3 Hz at 30 frames a second, slow sines the larger."""
        hertz = np.array([0.6, 1.5, 3.0]) * rng.uniform(0.8, 1.25, (3, 3))
        sizes = np.array([1.0, 0.5, 0.2]) * rng.uniform(0.6, 1.0, (3, 3))
        return Jitter(
            angles_rad=np.radians(angle_deg) * sizes,
            offsets_m=offset_m * sizes,
            rates_rad=2 * np.pi * hertz / 30.0,
            phases_rad=rng.uniform(0, 2 * np.pi, (3, 3)),
        )

    def at(self, frame: float) -> tuple[Floats, Floats]:
        """Rotation vector (3,) in radians and offset (3,) in metres at a (real-valued) frame."""
        waves = np.sin(self.phases_rad + self.rates_rad * frame)
        return np.sum(self.angles_rad * waves, axis=1), np.sum(self.offsets_m * np.roll(waves, 1, axis=0), axis=1)


@dataclass(frozen=True, eq=False)
class Path:
    """A camera path.

    Attributes
    ----------
    centre : callable
        Progress of the translation -> camera centre (3,) in the world, metres.
    angles : callable
        Progress of the rotation -> yaw, pitch, roll in radians, see :func:`orientation`.
    slow_start : float
        See :func:`progress`.
    move_from : float
        Frame at which the translation starts.
    jitter : Jitter or None
    """

    centre: Callable[[float], Floats]
    angles: Callable[[float], tuple[float, float, float]]
    slow_start: float
    move_from: float = 0.0
    jitter: Jitter | None = None

    def steady(self, moved: float, turned: float) -> Floats:
        """(4, 4) world_from_cam at given progress of translation and rotation, without jitter."""
        pose = np.eye(4)
        pose[:3, :3] = orientation(*self.angles(turned))
        pose[:3, 3] = self.centre(moved)
        return pose

    def world_from_cam(self, frame: float) -> Floats:
        """(4, 4) pose at a (real-valued) frame."""
        moved = progress(frame - self.move_from, self.slow_start)
        pose = self.steady(moved, progress(frame, self.slow_start))
        if self.jitter is not None:
            turn, offset = self.jitter.at(frame)
            pose[:3, :3] = pose[:3, :3] @ rotation_from_vector(turn)
            pose[:3, 3] += offset
        return pose


def rotation_from_vector(vector_rad: Floats) -> Floats:
    """(3, 3) rotation of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector_rad))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector_rad / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)
