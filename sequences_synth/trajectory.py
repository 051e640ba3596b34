"""Smooth motions of a camera on a hand, a drone or a tripod.

The z axis of the world points up; camera frames are optical (x right, y down, z forward). A path is defined for every
real-valued frame number, since motion blur needs poses between the frames.

Hand-held motion in seconds is a turning about an axis that changes, and a translation along an arc. The rotation vector
is a sum of two sines for each axis, whose amplitudes are scaled such that the angular speed has the requested root mean
square over the duration of the sequence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from sequences_synth.arrays import Floats

# A path is designed for 100 frames, in which the progress runs from 0 to about 1.
_FRAMES = 100.0
# In longer sequences the camera turns back, so that it does not leave the scene. For this, the progress is a sine whose
# slope is nearly 1 over the first 100 frames. PROGRESS_RANGE holds its least and largest possible value.
_PHASE = 0.5
PROGRESS_RANGE = (float(np.sin(_PHASE)) - 1.0, float(np.sin(_PHASE)) + 1.0)


def progress(frame: float, slow_start: float) -> float:
    """Compute the progress of the camera along its path: 0 at frame 0, about 1 at frame 100.

    * ``frame``: Frame number, not necessarily whole; the camera is at rest before 0.
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
    """Compute the rotation of a camera from yaw, pitch and roll; with zero angles it looks along the world's y axis.

    Shapes: returns (3, 3).
    """
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    yaw = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    pitch = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    level = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # x right, y down = -z, z forward = y
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    roll = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return np.asarray(yaw @ pitch @ level @ roll)


def draw_tremor(
    rng: np.random.Generator, angle_deg: float, offset_m: float
) -> Callable[[float], tuple[Floats, Floats]]:
    """Draw the tremor of a hand: a sum of three sines per axis, of 0.6 to 3 Hz at 30 frames per second.

    Slower sines have larger amplitudes.

    * Returns: Frame -> rotation vector (3,) in radians and offset (3,) in metres.
    """
    # Axis by sine.
    hertz = np.array([0.6, 1.5, 3.0]) * rng.uniform(0.8, 1.25, (3, 3))
    sizes = np.array([1.0, 0.5, 0.2]) * rng.uniform(0.6, 1.0, (3, 3))
    angles_rad, offsets_m, rates_rad = np.radians(angle_deg) * sizes, offset_m * sizes, 2 * np.pi * hertz / 30.0
    phases_rad = rng.uniform(0, 2 * np.pi, (3, 3))

    def at(frame: float) -> tuple[Floats, Floats]:
        waves = np.sin(phases_rad + rates_rad * frame)
        return np.sum(angles_rad * waves, axis=1), np.sum(offsets_m * np.roll(waves, 1, axis=0), axis=1)

    return at


@dataclass(frozen=True, eq=False)
class Path:
    """A camera path."""

    #: Progress of the translation -> camera centre (3,) in the world, metres.
    centre: Callable[[float], Floats]
    #: Progress of the rotation -> yaw, pitch, roll in radians, see :func:`orientation`.
    angles: Callable[[float], Floats]
    #: See :func:`progress`.
    slow_start: float
    #: Frame at which the translation starts.
    move_from: float = 0.0
    #: Tremor on top of the steady path, see :func:`draw_tremor`.
    tremor: Callable[[float], tuple[Floats, Floats]] | None = None

    def steady(self, moved: float, turned: float) -> Floats:
        """Compute a pose of the steady path, without tremor.

        Shapes: returns (4, 4).
        """
        pose = np.eye(4)
        pose[:3, :3] = orientation(*self.angles(turned))
        pose[:3, 3] = self.centre(moved)
        return pose

    def __call__(self, frame: float) -> Floats:
        """Compute the pose at a frame.

        Shapes: returns (4, 4).
        """
        moved = progress(frame - self.move_from, self.slow_start)
        pose = self.steady(moved, progress(frame, self.slow_start))
        if self.tremor is not None:
            turn, offset = self.tremor(frame)
            pose[:3, :3] = pose[:3, :3] @ rotation_from_vector(turn)
            pose[:3, 3] += offset
        return pose


def rotation_from_vector(vector_rad: Floats) -> Floats:
    """Compute the rotation matrix of a rotation vector by Rodrigues' formula.

    Shapes: ``vector_rad`` (3,), returns (3, 3).
    """
    angle = float(np.linalg.norm(vector_rad))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector_rad / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def rotations_from_vectors(vectors_rad: Floats) -> Floats:
    """Compute the rotation matrices of many rotation vectors, as :func:`rotation_from_vector` does for one.

    Shapes: ``vectors_rad`` (N, 3), returns (N, 3, 3).
    """
    angle = np.linalg.norm(vectors_rad, axis=1)
    axis = vectors_rad / np.where(angle > 0, angle, 1.0)[:, None]
    cross = np.zeros((len(vectors_rad), 3, 3))
    cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0] = axis.T
    cross -= cross.transpose(0, 2, 1)
    sine, versine = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


def vector_from_rotation(rotation: Floats) -> Floats:
    """Compute the rotation vector of a rotation matrix by less than half a turn.

    Shapes: ``rotation`` (3, 3), returns (3,).
    """
    (_, b, c), (d, _, f), (g, h, _) = rotation.tolist()
    # The axis times twice the sine of the angle.
    doubled = np.array([h - f, c - g, d - b])
    size = float(np.linalg.norm(doubled))
    angle = np.arctan2(size, np.trace(rotation) - 1)
    return np.asarray(doubled * (angle / size) if size > 0 else doubled)


# -- in seconds ------------------------------------------------------------------------------------


# A person who looks around with a camera swings it in one to three seconds, the wrist a little faster.
_HERTZ = np.array([0.4, 0.8])
_SIZES = np.array([1.0, 0.5])
# Instants per second at which the speed is measured: the fastest sine has 30 of them in a period.
_RATE_HZ = 60.0
_SCALINGS = 12
# A rotation vector of more than 2 rad comes near half a turn, where the speed no longer grows with its amplitude.
_LARGEST_RAD = 2.0
#: The path of a hand bends by this much in a second, radians.
BEND_RAD_S = (0.2, 0.8)


@dataclass(frozen=True)
class Handling:
    """How a camera is handled."""

    #: Time from the first to the last frame.
    duration_s: float
    #: Root mean square of the angular speed over this time.
    turning_deg_s: float
    #: Speed of the translation, median depths per second.
    speed: float


def draw_turning(
    rng: np.random.Generator, handling: Handling, largest_tilt_deg: float = np.inf
) -> Callable[[Floats], Floats]:
    """Draw a hand-held turning with the requested angular speed: a rotation vector whose axes each have two sines.

    * ``largest_tilt_deg``: The optical axis stays within about this angle of that without turning. The hand then
      trembles faster.
    * Returns: Time (...) in seconds -> rotation vector (..., 3).
    """
    # Axis by sine.
    rates = 2 * np.pi * _HERTZ * rng.uniform(0.8, 1.25, (3, 2))
    sizes = _SIZES * rng.uniform(0.7, 1.0, (3, 2))
    phases = rng.uniform(0, 2 * np.pi, (3, 2))
    if handling.turning_deg_s == 0.0:
        return partial(_turned, 0 * sizes, rates, phases)
    # Faster sines have the same speed at a smaller amplitude: the rates grow until both bounds hold.
    while True:
        turning = partial(_turned, _at_speed(sizes, rates, phases, handling), rates, phases)
        vectors = turning(handling.duration_s * np.linspace(0, 1, 200))
        tilt_deg = float(np.degrees(np.linalg.norm(vectors[:, :2], axis=1).max()))
        if tilt_deg <= largest_tilt_deg and float(np.linalg.norm(vectors, axis=1).max()) <= _LARGEST_RAD:
            return turning
        rates = 1.2 * rates


def _turned(sizes_rad: Floats, rates_rad_s: Floats, phases_rad: Floats, time_s: Floats) -> Floats:
    angles = phases_rad + rates_rad_s * np.asarray(time_s)[..., None, None]
    return np.asarray(np.sum(sizes_rad * np.sin(angles), axis=-1))


def _at_speed(sizes_rad: Floats, rates_rad_s: Floats, phases_rad: Floats, handling: Handling) -> Floats:
    """The amplitudes at which a turning has the requested speed."""
    rate_hz, duration_s = _RATE_HZ * float(np.max(rates_rad_s)) / (2 * np.pi * _HERTZ[-1]), handling.duration_s
    times_s = np.linspace(0, duration_s, 2 + int(np.ceil(rate_hz * duration_s)))
    for _ in range(_SCALINGS):
        R = rotations_from_vectors(_turned(sizes_rad, rates_rad_s, phases_rad, times_s))
        # The chord of a small rotation: |A - B| = 2 sqrt(2) sin(angle / 2).
        chords = np.linalg.norm(np.diff(R, axis=0), axis=(1, 2))
        steps_rad = 2 * np.arcsin(np.minimum(chords / np.sqrt(8), 1.0))
        speed_deg_s = float(np.degrees(np.sqrt(np.mean(steps_rad**2)) * len(steps_rad) / duration_s))
        sizes_rad = sizes_rad * (handling.turning_deg_s / speed_deg_s)
        if np.abs(_turned(sizes_rad, rates_rad_s, phases_rad, np.zeros(1))).max() > 10 * _LARGEST_RAD:
            break
    return sizes_rad


def arc(speed: float, bend_rad_s: float, along: Floats, across: Floats) -> Callable[[Floats], Floats]:
    """Make an arc of a circle that is travelled at a constant speed.

    Shapes: ``along, across`` (3,).

    * ``speed``: Per second; exactly no translation where it is 0.
    * ``bend_rad_s``: Angular velocity of the direction of motion.
    * ``along, across``: Orthonormal: direction of the first velocity, and direction to which the path bends.
    * Returns: Time (...) in seconds -> camera centre (..., 3).
    """

    def position(time_s: Floats) -> Floats:
        angle = bend_rad_s * np.asarray(time_s)[..., None]
        return np.asarray(speed / bend_rad_s * (np.sin(angle) * along + (1 - np.cos(angle)) * across))

    return position
