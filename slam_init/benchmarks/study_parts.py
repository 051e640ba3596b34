"""The worlds of the study (:mod:`slam_init.benchmarks.study`): which scenes, drawn from which distribution.

All are tracks without images: about 300 in each of 12 views, 0.1 s apart, at 640x480 and a focal length of 458 px.
Unless a part says otherwise each world draws, independently and evenly,

* the noise of a coordinate from 0.3, 0.7 and 1.0 px,
* the share of wrong matches from 5, 15 and 30 %,
* the way of the camera from first to last view over the median depth of the scene from .03, .05, .1, .15 and .3,

and is stated with its true focal length. Geometry, motion and noise come from the world's own seed. With little way and
much noise no method can succeed; what the information allows is the part ``noise-baseline``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

from slam_init.compare.sources import GRID, ComparedSource, describe_sources, drawn_sources

__all__ = ["GENERAL", "NOISES_PX", "PARTS", "PLANAR", "Cell", "Part", "grid_name", "sources_of"]

GENERAL = ("room", "corridor", "rotate-then-move")
PLANAR = ("wall", "nadir-turn", "desk", "nadir")
#: A row each in the table of noise against baseline: up to where no track is that bad.
NOISES_PX = (0.3, 0.7, 1.0, 2.0)

#: Two bodies that hold 30 % of the tracks together; with 30 % of wrong matches four tracks of ten are left.
_MOVING = {"moving": 0.3}
_NOISY = {"noise_px": 1.0}


@dataclass(frozen=True)
class Cell:
    """Worlds that are counted together.

    Attributes
    ----------
    name : str
    sources : tuple of str
        What :func:`slam_init.compare.sources.open_compared` takes.
    """

    name: str
    sources: tuple[str, ...]


@dataclass(frozen=True)
class Part:
    """One table.

    Attributes
    ----------
    title : str
    text : str
        What the reader has to know.
    cells : callable
        ``cells(trials, seed)``: the rows of the table.
    still : bool
        The camera never translates: every map is false.
    """

    title: str
    text: str
    cells: Callable[[int, int], list[Cell]]
    still: bool = False


def _worlds(scenes: Sequence[str], trials: int, seed: int, **fixed: float) -> tuple[str, ...]:
    """So many worlds, spread over the scenes."""
    each = [drawn_sources(scene, -(-trials // len(scenes)), seed, **{"focal_error": 0.0, **fixed}) for scene in scenes]
    return tuple(text for texts in zip(*each, strict=True) for text in texts)[:trials]


def _scene_by_scene(scenes: Sequence[str]) -> Callable[[int, int], list[Cell]]:
    return lambda trials, seed: [Cell(scene, _worlds((scene,), trials, seed)) for scene in scenes]


def _still(trials: int, seed: int) -> list[Cell]:
    focal_lengths = (("true focal length", 0.0), ("5 % too long", 0.05), ("5 % too short", -0.05))
    cells = [
        Cell(f"{scene}, {name}", _worlds((scene,), trials, seed, focal_error=error))
        # Without motion all focal lengths show the same.
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


def grid_name(scene: str, noise_px: float, baseline: float) -> str:
    """Name of a cell of noise against baseline."""
    return f"{scene}, {noise_px:g} px, {baseline:g}"


def _noise_baseline(trials: int, seed: int) -> list[Cell]:
    return [
        Cell(
            grid_name(scene, noise_px, baseline),
            _worlds((scene,), trials, seed, noise_px=noise_px, baseline=baseline, outliers=0.1),
        )
        for scene, noise_px, baseline in product(("room", "wall"), NOISES_PX, GRID["baseline"])
    ]


def sources_of(cells: Sequence[Cell]) -> tuple[ComparedSource, ...]:
    """The worlds of all cells, each once: one that drew what another cell fixes is in both."""
    return tuple(describe_sources(list(dict.fromkeys(text for cell in cells for text in cell.sources))))


PARTS: dict[str, Part] = {
    "general": Part(
        "General scenes",
        "A room, a corridor along its axis, a pan that goes over into a translation.",
        _scene_by_scene(GENERAL),
    ),
    "planar": Part(
        "Planes",
        "A wall, level flight with a turn, a desk with things on it, level straight flight.",
        _scene_by_scene(PLANAR),
    ),
    "still": Part(
        "No translation",
        "Every map is false. *Suspected*: a check took the stated focal length for wrong; *told*: the result says so. "
        "At the true focal length both are false alarms.",
        _still,
        still=True,
    ),
    "hard": Part(
        "Hard reality",
        "30 % of the tracks on two bodies that move on their own, as fast as the camera; noise of 1 px in every world; "
        "both. General is room and corridor, planar is wall, nadir-turn and desk.",
        _hard,
    ),
    "noise-baseline": Part(
        "Where the information ends",
        "The first method, 10 % wrong matches: correct / false / none (and how many worlds least squares solves from "
        "the truth, on the right tracks alone), by the noise of a coordinate (rows) and the way of the camera over the "
        "median depth (columns).",
        _noise_baseline,
    ),
}
