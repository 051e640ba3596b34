"""The scenes by name: their surfaces, and the path of the camera.

Sizes are in metres; the z axis of the world points up. Each builder draws the path and keeps objects away from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.boards import moving_boards, moving_cards, tag_board
from sequences_synth.builder import Setup
from sequences_synth.hand_scenes import HandPath, handheld, handheld_wall, pan
from sequences_synth.options import SynthOptions
from sequences_synth.planes import nadir, nadir_turn, tilted, wall
from sequences_synth.room_scenes import corridor, desk, room, rotate_then_move, rotation, static
from sequences_synth.textured_quad import Quad
from sequences_synth.trajectory import Handling, Path

# The angular speed of hand-held turning is a root mean square over this time. It does not depend on the number of
# frames, so that a longer sequence continues the path of a shorter one.
_HANDLING_S = 10.0


@dataclass(frozen=True, eq=False)
class World:
    """A scene and the path of the camera through it."""

    #: All surfaces; those of moving objects come last.
    quads: tuple[Quad, ...]
    path: Path | HandPath
    #: (float, float) The exposure changes slowly as a sine: its phase at frame 0 and its advance per frame, radians.
    exposure_phase: tuple[float, float]


def build_world(name: str, entropy: tuple[int, ...], K: Floats, options: SynthOptions) -> World:
    """Build a scene.

    Shapes: ``K`` (3, 3).
    """
    rng = np.random.default_rng(entropy)
    handling = Handling(_HANDLING_S, options.turning_deg_s, options.speed)
    setup = Setup(rng, entropy, K, options.width, options.height, options.slow_start, options.fps, handling)
    quads, path = _BUILDERS[name](setup)
    phase = (float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0.03, 0.09)))
    if options.tag_m > 0:
        quads = [*quads, tag_board(setup, path.world_from_cam, quads, options.tag_m)]
    if options.moving_objects > 0:
        if not isinstance(path, Path):
            share = options.moving_objects
            raise ValueError(f"moving_objects is {share}: scene {name} has bodies instead, option moving")
        quads = quads + moving_cards(setup, path, quads, options.moving_objects)
    if options.moving > 0:
        body_rng = np.random.default_rng((*entropy, *b" bodies"))
        quads = quads + moving_boards(
            setup, body_rng, path.world_from_cam, quads, options.moving, options.bodies, options.body_turn_deg_s
        )
    return World(tuple(quads), path, phase)


_BUILDERS: dict[str, Callable[[Setup], tuple[list[Quad], Path | HandPath]]] = {
    "room": room,
    "wall": wall,
    "nadir": nadir,
    "nadir-turn": nadir_turn,
    "corridor": corridor,
    "desk": desk,
    "rotation": rotation,
    "rotate-then-move": rotate_then_move,
    "static": static,
    "tilted-15": tilted(15.0),
    "tilted-30": tilted(30.0),
    "tilted-45": tilted(45.0),
    "handheld": handheld,
    "handheld-wall": handheld_wall,
    "pan": pan,
}

#: Names of the rendered scenes.
SCENES: tuple[str, ...] = tuple(_BUILDERS)
#: Scenes that grids and benchmarks draw by default, rendered or as points. This list is fixed, so that measured tables
#: stay comparable when scenes are added. Other scenes are reached by name.
STANDARD_SCENES: tuple[str, ...] = (
    "room",
    "wall",
    "nadir",
    "nadir-turn",
    "corridor",
    "desk",
    "rotation",
    "rotate-then-move",
    "static",
)
