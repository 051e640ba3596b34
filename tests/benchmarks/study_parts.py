"""The worlds of the study (:mod:`tests.benchmarks.study`): their scenes and the distribution of their parameters.

All worlds are tracks without images: about 300 tracks in each of 12 views, 0.1 s apart, with 640x480 pixels and a focal
length of 458 px. Unless a part says otherwise, each world draws independently and uniformly

* the noise of a coordinate from 0.3, 0.7 and 1.0 px,
* the share of outliers from 5, 15 and 30 %,
* the baseline from the first to the last view over the median depth from 0.03, 0.05, 0.1, 0.15 and 0.3.

The stated focal length is the true one. Geometry, motion and noise are drawn with the seed of the world. No method can
succeed with a short baseline and much noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

from slam_init.compare.sources import ComparedSource, describe_sources, simulated_sources

GENERAL = ("room", "corridor", "rotate-then-move")
PLANAR = ("wall", "nadir-turn", "desk", "nadir")
TILTED = ("tilted-15", "tilted-30", "tilted-45")
#: Baselines over the median depth at which the parallax is near the noise.
SHORT_BASELINES = (0.03, 0.05, 0.1)
#: Root mean square of a smooth error that the tracks of a view share, as measured on film.
FIELD_PX = 0.15

#: 30 % of the tracks lie on two moving bodies. With 30 % of outliers as well, four tracks of ten follow the camera.
_MOVING = {"moving": 0.3}
_NOISY = {"noise_px": 1.0}


@dataclass(frozen=True)
class Cell:
    """Worlds that are counted together."""

    name: str
    #: Arguments of :func:`slam_init.compare.sources.open_compared`.
    sources: tuple[str, ...]


@dataclass(frozen=True)
class Part:
    """One part of the study, which is one table."""

    title: str
    #: Text above the table.
    text: str
    #: ``cells(trials, seed)`` returns the rows of the table.
    cells: Callable[[int, int], list[Cell]]
    #: The camera never translates, so every map is false.
    no_translation: bool = False


def _worlds(scenes: Sequence[str], trials: int, seed: int, **fixed: float) -> tuple[str, ...]:
    """Return ``trials`` worlds, distributed evenly over the scenes."""
    each = [
        simulated_sources(scene, -(-trials // len(scenes)), seed, **{"focal_error": 0.0, **fixed}) for scene in scenes
    ]
    return tuple(text for texts in zip(*each, strict=True) for text in texts)[:trials]


def _scene_by_scene(scenes: Sequence[str]) -> Callable[[int, int], list[Cell]]:
    return lambda trials, seed: [Cell(scene, _worlds((scene,), trials, seed)) for scene in scenes]


def _static(trials: int, seed: int) -> list[Cell]:
    focal_lengths = (("true focal length", 0.0), ("5 % too long", 0.05), ("5 % too short", -0.05))
    cells = [
        Cell(f"{scene}, {name}", _worlds((scene,), trials, seed, focal_error=error))
        # In a static scene the focal length has no effect, so one wrong value is enough.
        for scene, stated in (("rotation", focal_lengths), ("static", focal_lengths[:2]))
        for name, error in stated
    ]
    return [*cells, Cell("rotation, 30 % moving, 1 px", _worlds(("rotation",), trials, seed, **_MOVING, **_NOISY))]


def _hard(trials: int, seed: int) -> list[Cell]:
    conditions = (("30 % moving", _MOVING), ("1 px noise", _NOISY), ("both", _MOVING | _NOISY))
    kinds = (("general", ("room", "corridor")), ("planar", ("wall", "nadir-turn", "desk")))
    return [
        Cell(f"{name}, {kind}", _worlds(scenes, trials, seed, **fixed))
        for (name, fixed), (kind, scenes) in product(conditions, kinds)
    ]


def _slow_planes(trials: int, seed: int) -> list[Cell]:
    return [
        Cell(f"planes, {baseline:g}", _worlds(PLANAR, trials, seed, baseline=baseline)) for baseline in SHORT_BASELINES
    ]


def _tilted(trials: int, seed: int) -> list[Cell]:
    return [
        Cell(f"{scene}, {baseline:g}", _worlds((scene,), trials, seed, baseline=baseline))
        for scene, baseline in product(TILTED, (0.05, 0.1, 0.3))
    ]


def _wrong_focal(trials: int, seed: int) -> list[Cell]:
    return [
        Cell(f"rotation, {100 * error:+g} %", _worlds(("rotation",), trials, seed, focal_error=error))
        for error in (-0.1, -0.05, -0.02, 0.02, 0.05, 0.1)
    ]


def _error_field(trials: int, seed: int) -> list[Cell]:
    moving = (("general", GENERAL), ("planar", PLANAR), ("tilted", TILTED))
    return [Cell(name, _worlds(scenes, trials, seed, field_px=FIELD_PX)) for name, scenes in moving]


def _error_field_still(trials: int, seed: int) -> list[Cell]:
    return [Cell(scene, _worlds((scene,), trials, seed, field_px=FIELD_PX)) for scene in ("rotation", "static")]


def sources_of(cells: Sequence[Cell]) -> tuple[ComparedSource, ...]:
    """Return the worlds of all cells, each once. Two cells can contain the same world."""
    return tuple(describe_sources(list(dict.fromkeys(text for cell in cells for text in cell.sources))))


PARTS: dict[str, Part] = {
    "general": Part(
        "General scenes",
        "A room, a corridor along its axis, a rotation that is followed by a translation.",
        _scene_by_scene(GENERAL),
    ),
    "planar": Part(
        "Planes",
        "A wall, level flight with a turn, a desk with objects on it, level straight flight.",
        _scene_by_scene(PLANAR),
    ),
    "static": Part(
        "No translation",
        "Every map is false. *Focal error suspected*: an attempt suspects that the stated focal length is wrong; "
        "*focal error reported*: the result reports it. With the true focal length both are false alarms.",
        _static,
        no_translation=True,
    ),
    "slow-planes": Part(
        "Planes at short baselines",
        "A wall, a desk, level flight, level flight with a turn.",
        _slow_planes,
    ),
    "tilted": Part(
        "Level flight with a tilted camera",
        "Straight and level over flat ground; the camera is tilted by 15, 30 or 45 degrees from straight down.",
        _tilted,
    ),
    "wrong-focal": Part(
        "Turning cameras with a wrong focal length",
        "Every map is false. The stated focal length is too short or too long.",
        _wrong_focal,
        no_translation=True,
    ),
    "field": Part(
        "Errors that the tracks of a view share",
        f"A smooth error field of {FIELD_PX:g} px in each view, drawn anew for each view.",
        _error_field,
    ),
    "field-still": Part(
        "The same errors without translation",
        f"A smooth error field of {FIELD_PX:g} px in each view. Every map is false.",
        _error_field_still,
        no_translation=True,
    ),
    "hard": Part(
        "Moving bodies and noise",
        "30 % of the tracks lie on two bodies that move independently, as fast as the camera; noise of 1 px in every "
        "world; both. General scenes are room and corridor, planar scenes are wall, nadir-turn and desk.",
        _hard,
    ),
}
