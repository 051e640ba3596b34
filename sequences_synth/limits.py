"""The range of each option, and the check of all options of a sequence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields
from difflib import get_close_matches
from typing import Any

from sequences_synth.shutter import READOUT_DIRECTIONS

#: The lowest and the highest value of options, by their names.
Limits = Mapping[str, tuple[float, float]]

#: The options that drawn and rendered sequences have in common. Beyond the limits of k1, the lens would not be
#: invertible within the image.
EFFECT_LIMITS: dict[str, tuple[float, float]] = {
    "fps": (1e-3, 1e4), "focal_error": (-0.9, 10), "readout_ms": (0, 1e6), "exposure_ms": (0, 1e6),
    "turning_deg_s": (0, 1000), "speed": (0, 100), "body_turn_deg_s": (0, 1000), "principal_error": (0, 0.5),
    "k1": (-0.2, 1), "stabilized": (0, 1), "dropped": (0, 0.9), "repeated": (0, 0.9),
}  # fmt: skip


def unknown_scene(name: str, scenes: Iterable[str]) -> str:
    """The message about a scene that does not exist: the nearest name, and all."""
    known = list(scenes)
    meant = get_close_matches(name, known, n=1)
    hint = f"did you mean {meant[0]}? " if meant else ""
    return f"unknown scene {name!r}: {hint}use one of {', '.join(known)}"


def check_options(options: Any, limits: Limits) -> None:
    """Check the options of a sequence.

    * ``options``: With ``fps``, ``readout_ms``, ``readout_direction`` and ``exposure_ms``.
    """
    for name in (field.name for field in fields(options) if field.name in limits):
        value, (low, high) = getattr(options, name), limits[name]
        if not (math.isfinite(value) and low <= value <= high):
            raise ValueError(f"{name} is {value!r}: it must lie between {low} and {high}")
    if options.readout_direction not in READOUT_DIRECTIONS:
        known = ", ".join(READOUT_DIRECTIONS)
        raise ValueError(f"readout_direction is {options.readout_direction!r}: use one of {known}")
    for name in ("readout_ms", "exposure_ms"):
        value, interval_ms = getattr(options, name), 1000 / options.fps
        if value > interval_ms:
            raise ValueError(f"{name} is {value}: it must not exceed the frame interval, {interval_ms:g} ms")
