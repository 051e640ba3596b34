"""The options of the sequences, rendered or of tracks alone, and their ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from difflib import get_close_matches

import numpy as np

from sequences_synth.camera import LENSES, READOUT_DIRECTIONS

# The lowest and the highest value of options, by their names. Beyond the limits of k1, the lens would not be invertible
# within the image.
_EFFECT_LIMITS: dict[str, tuple[float, float]] = {
    "fps": (1e-3, 1e4), "focal_error": (-0.9, 10), "principal_error": (0, 0.5), "k1": (-0.2, 1), "readout_ms": (0, 1e6),
    "turning_deg_s": (0, 1000), "speed": (0, 100),
}  # fmt: skip
_POINT_LIMITS = _EFFECT_LIMITS | {
    "views": (2, 10_000), "points": (1, 100_000), "noise_px": (0, 100), "outliers": (0, 1), "baseline": (0, 10),
    "moving": (0, 1), "objects": (1, 100), "object_deg_s": (0, 1000), "correlated_px": (0, 100), "drift_px": (0, 100),
}  # fmt: skip
_RENDERED_LIMITS = _EFFECT_LIMITS | {
    "frames": (1, 100_000), "width": (64, 4096), "height": (64, 4096), "noise": (0, 100), "motion_blur": (0, 1),
    "exposure_change": (0, 0.9), "slow_start": (0, 100_000), "cut": (0, 100_000),
}  # fmt: skip


@dataclass(frozen=True)
class EffectOptions:
    """Options that rendered sequences and tracks have in common; the same for every scene.

    Attributes
    ----------
    fps : float
        Frames per second. In the scenes ``handheld``, ``handheld-wall`` and ``pan`` it decides how far the camera turns
        from frame to frame. In the other scenes it changes the time stamps only.
    focal_error : float
        The stated focal length is the true one times ``1 + focal_error``.
    principal_error : float
        Error of the stated principal point: horizontally over the width, vertically over the height. The signs are
        random.
    k1 : float
        Coefficient of radial distortion of the true camera, which the stated camera lacks.
    readout_ms : float
        Readout time of the rolling shutter, at most a frame interval; 0 for a global shutter. See
        :mod:`sequences_synth.camera`.
    readout_direction : str
        Order in which rows or columns are read: ``down``, ``up``, ``right`` or ``left``.
    turning_deg_s : float
        Root mean square of the angular speed in the scenes ``handheld`` and ``handheld-wall`` (of rendered ones over
        10 s), and speed of the scene ``pan``. The other scenes ignore it.
    speed : float
        Speed of the translation in the scenes ``handheld`` and ``handheld-wall``, median depths per second. The median
        depth of the rendered room is taken as 3 m. The other scenes ignore it.
    """

    fps: float = 30.0
    focal_error: float = 0.0
    principal_error: float = 0.0
    k1: float = 0.0
    readout_ms: float = 0.0
    readout_direction: str = "down"
    turning_deg_s: float = 60.0
    speed: float = 0.0

    def _check(self, limits: Mapping[str, tuple[float, float]]) -> None:
        for name in (field.name for field in fields(self) if field.name in limits):
            value, (low, high) = getattr(self, name), limits[name]
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"{name} is {value!r}: it must lie between {low} and {high}")
        if self.readout_direction not in READOUT_DIRECTIONS:
            known = ", ".join(READOUT_DIRECTIONS)
            raise ValueError(f"readout_direction is {self.readout_direction!r}: use one of {known}")
        if self.readout_ms > 1000 / self.fps:
            limit = f"it must not exceed the frame interval, {1000 / self.fps:g} ms"
            raise ValueError(f"readout_ms is {self.readout_ms}: {limit}")


@dataclass(frozen=True)
class PointOptions(EffectOptions):
    """Options of a sequence of tracks, besides those of :class:`EffectOptions`.

    Attributes
    ----------
    views : int
        Number of frames.
    points : int
        Approximate number of tracks in a view.
    noise_px : float
        Standard deviation of one coordinate of a pixel.
    outliers : float
        Share of the tracks that are outliers: in each view at a random place in the image.
    moving : float
        Share of the tracks on moving objects.
    objects : int
        Number of these objects.
    object_deg_s : float
        Angular speed of each object about its own centre, about random axes.
    baseline : float
        Distance of the camera from first to last view over the median depth. Where the camera does not translate, and
        in ``handheld`` and ``handheld-wall``, it is only the scale of the motion of objects.
    correlated_px : float
        Root mean square over the image of one coordinate of the correlated tracking error: a smooth field that the
        tracks of a view have in common. The field of each view is independent of the others. Outliers do not have it.
    drift_px : float
        The same for a smooth field that performs a random walk over the views: 0 in the first view, and ``drift_px`` in
        the last one.

    Raises
    ------
    ValueError
        If an option is out of range; the message names the option.
    """

    views: int = 12
    points: int = 300
    noise_px: float = 0.7
    outliers: float = 0.1
    baseline: float = 0.15
    correlated_px: float = 0.0
    drift_px: float = 0.0
    fps: float = 10.0
    moving: float = 0.0
    objects: int = 2
    object_deg_s: float = 0.0

    def __post_init__(self) -> None:
        self._check(_POINT_LIMITS)
        if self.outliers + self.moving > 1:
            raise ValueError(f"outliers and moving are {self.outliers} and {self.moving}: together at most 1")


@dataclass(frozen=True)
class SynthOptions(EffectOptions):
    """Options of rendered images, besides those of :class:`EffectOptions`.

    Attributes
    ----------
    frames : int
        Number of frames. A longer sequence continues the path of a shorter one.
    width, height : int
        Image size in pixels.
    noise : float
        Standard deviation of the luminance at mid grey, grey levels (shot and read noise).
    motion_blur : float
        Exposure as a fraction of the frame interval, 0 to 1: each image is blurred along its flow.
    exposure_change : float
        Relative amplitude of a slow change of gain: 0.08 is 8 % up and down.
    slow_start : int
        Number of frames over which the motion rises from rest to full speed. The scenes ``handheld``,
        ``handheld-wall`` and ``pan`` move from the first frame on.
    lens : str
        ``pinhole``, or one of :data:`sequences_synth.camera.LENSES`, with usual parameters that the stated camera
        has as well. It has no ``k1``.
    cut : int
        Position of the frame at which another scene of the same kind begins; 0 for none. The poses of the second scene
        have the world frame of the second scene: they have no relation to those before.
    imu : bool
        Whether an inertial sensor of a phone is fixed to the camera (:mod:`sequences_synth.inertial`), at 200 Hz.

    Raises
    ------
    ValueError
        If an option is out of range; the message names the option.
    """

    frames: int = 100
    width: int = 640
    height: int = 480
    noise: float = 3.0
    motion_blur: float = 0.3
    exposure_change: float = 0.06
    slow_start: int = 12
    lens: str = "pinhole"
    cut: int = 0
    imu: bool = False

    def __post_init__(self) -> None:
        self._check(_RENDERED_LIMITS)
        if self.readout_direction not in ("down", "up"):
            raise ValueError(f"readout_direction is {self.readout_direction!r}: rows are read here: use down or up")
        if self.cut >= self.frames:
            raise ValueError(f"cut is {self.cut}: it must be less than the number of frames, {self.frames}")
        if self.imu and self.cut:
            raise ValueError("imu is 1: it needs one path of the camera, so leave cut out")
        if self.lens not in ("pinhole", *LENSES):
            raise ValueError(f"lens is {self.lens!r}: use one of pinhole, {', '.join(LENSES)}; fisheye is the widest")
        if self.lens != "pinhole" and self.k1:
            raise ValueError(f"lens is {self.lens!r}: k1 needs lens=pinhole")


def check_scene(name: str, seed: int, scenes: Sequence[str]) -> None:
    """Refuse a scene that does not exist, by the nearest name and all, and a negative seed."""
    if name not in scenes:
        meant = get_close_matches(name, scenes, n=1)
        hint = f"did you mean {meant[0]}? " if meant else ""
        raise ValueError(f"unknown scene {name!r}: {hint}use one of {', '.join(scenes)}")
    if seed < 0:
        raise ValueError(f"seed is {seed}: it must not be negative")


def stream(seed: int, purpose: bytes, name: str) -> np.random.Generator:
    """Make a generator for one effect. The options of the effect then change neither the scene nor the noise."""
    return np.random.default_rng((seed, *purpose, *name.encode()))
