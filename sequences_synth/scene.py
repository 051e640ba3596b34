"""The scenes by name: their surfaces, and the path of the camera.

Sizes are in metres; the z axis of the world points up. Each builder draws the path and keeps objects away from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sequences_synth.boards import moving_boards, nearest_ahead
from sequences_synth.builder import Setup
from sequences_synth.hand_motion import Handling
from sequences_synth.hand_scenes import HandPath, handheld, handheld_wall, pan
from sequences_synth.indoors import corridor, desk
from sequences_synth.planes import nadir, nadir_turn, tilted, wall
from sequences_synth.room_scenes import room, rotate_then_move, rotation, static
from sequences_synth.tags import tag_board
from sequences_synth.textured_quad import Quad
from sequences_synth.trajectory import Path, progress

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class World:
    """A scene and the path of the camera through it."""

    #: All surfaces; those of moving objects come last.
    quads: tuple[Quad, ...]
    path: Path | HandPath
    #: (float, float) The exposure changes slowly as a sine: its phase at frame 0 and its advance per frame, radians.
    exposure_phase: tuple[float, float]


@dataclass(frozen=True)
class Motions:
    """What moves in a world, and how."""

    #: Number of frames over which the motion of the camera rises to full speed, see
    #: :func:`sequences_synth.trajectory.progress`.
    slow_start: float
    #: Frames per second, for scenes whose motion is in seconds.
    fps: float
    #: How the camera of these scenes is handled.
    handling: Handling
    #: Approximate share of the image area that swaying cards cover; 0 for none.
    cards: float
    #: Share of the image area that bodies cover; 0 for none.
    boards: float
    #: Number of these bodies.
    bodies: int
    #: Root mean square of their angular speed.
    body_turn_deg_s: float
    #: Side of an AprilTag in the scene, metres; 0 for none. It is at rest.
    tag_m: float = 0.0


def build_world(name: str, entropy: tuple[int, ...], K: Floats, width: int, height: int, motions: Motions) -> World:
    """Build a scene.

    Shapes: ``K`` (3, 3).
    """
    rng = np.random.default_rng(entropy)
    setup = Setup(rng, entropy, K, width, height, motions.slow_start, motions.fps, motions.handling)
    quads, path = _BUILDERS[name](setup)
    phase = (float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0.03, 0.09)))
    if motions.tag_m > 0:
        quads = [*quads, tag_board(setup, path.world_from_cam, quads, motions.tag_m)]
    if motions.cards > 0:
        if not isinstance(path, Path):
            raise ValueError(f"moving_objects is {motions.cards}: scene {name} has bodies instead, option moving")
        quads = quads + _moving_cards(setup, path, quads, motions.cards)
    if motions.boards > 0:
        body_rng = np.random.default_rng((*entropy, *b" bodies"))
        quads = quads + moving_boards(
            setup, body_rng, path.world_from_cam, quads, motions.boards, motions.bodies, motions.body_turn_deg_s
        )
    return World(tuple(quads), path, phase)


def _moving_cards(setup: Setup, path: Path, quads: list[Quad], share: float) -> list[Quad]:
    """Boards that sway in front of the camera; together they cover about the given share of the image.

    The boards follow the steady path of the camera, so that they stay in view.
    """
    rng = setup.rng
    pose = path.steady(0.0, 0.0)
    right, down, ahead = pose[:3, 0], pose[:3, 1], pose[:3, 2]
    # The boards are clearly nearer than the scene, so that they never intersect it.
    distance = 0.6 * nearest_ahead(setup, quads, pose)
    view_w, view_h = distance * setup.width / setup.K[0, 0], distance * setup.height / setup.K[1, 1]
    count = 3
    painter = setup.painter(pose[:3, 3], distance)
    painter.count = len(quads)
    cards = []
    for i in range(count):
        w, h = view_w * np.sqrt(share / count), view_h * np.sqrt(share / count)
        x = view_w * ((i + 0.5) / count - 0.5)
        y = rng.uniform(-0.5, 0.5) * (view_h - h)
        corner = pose[:3, 3] + (1 - 0.05 * i) * distance * ahead + (x - 0.5 * w) * right + (y - 0.5 * h) * down
        sway, rate, phase = 0.12 * view_w * setup.random_sign(), rng.uniform(0.05, 0.09), rng.uniform(0, 2 * np.pi)

        def displacement(frame: float, sway: float = sway, rate: float = rate, phase: float = phase) -> Floats:
            moved = progress(frame - path.move_from, path.slow_start)
            carried = path.centre(moved) - path.centre(0.0)
            return np.asarray(
                carried + sway * (np.sin(phase + rate * frame) * right + 0.4 * np.cos(phase + rate * frame) * down)
            )

        cards.append(painter.quad(corner, w * right, h * down, "print", displacement=displacement))
    return cards


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
