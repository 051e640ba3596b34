"""Boards in front of the camera: bodies that move and turn, cards that sway, and a tag of known size.

The bodies are textured boards that fill a stated share of the view. They follow the gaze of the camera, as a person
does whom the camera follows, so that their share of the view is the same in every frame. In the frame of the camera
they sway and oscillate about their own vertical axes. A pair of views in which most tracks lie on one board therefore
shows the rigid motion of this board.

The tag is an AprilTag of the family 36h11, on a board that faces the camera at first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sequences_synth.arrays import Floats, Image
from sequences_synth.builder import Setup
from sequences_synth.texture import Texture, halved
from sequences_synth.textured_quad import Quad
from sequences_synth.trajectory import Path, progress, rotation_from_vector

# Amplitude of the turning, radians: at more than 40 degrees a board would hide itself.
_TURN_RAD = np.radians(35.0)
# Mean of cos(_TURN_RAD sin x) over x: a board that turns looks narrower on average by this factor.
_NARROWER = 0.909
# Sway of a board, share of the gap between it and the border of its part of the view, and its largest value in shares
# of the view.
_SWAY, _LARGEST_SWAY = 0.8, 0.1
# Hertz of the sway: as of a person who moves about.
_SWAY_HZ = (0.25, 0.5)
# Nearest distance over that of the scene: the boards never intersect the scene.
_NEARER = 0.55
# Frames at which the distance of the scene is measured.
_FRAMES = np.linspace(0, 600, 41)


@dataclass(frozen=True, eq=False)
class _BoardMotion:
    """The motion of a board in the frame of the camera, with the path of the camera itself."""

    world_from_cam: Callable[[float], Floats]
    fps: float
    place: Floats  # (3,) in the frame of the camera, metres
    sway: Floats  # (3,) metres
    rates_rad_s: Floats  # (3,)
    phases_rad: Floats  # (3,)
    turn_rad: float
    turn_rate_rad_s: float
    turn_phase_rad: float

    def __call__(self, frame: float) -> Floats:
        time_s = frame / self.fps
        pose = np.eye(4)
        angle = self.turn_rad * np.sin(self.turn_phase_rad + self.turn_rate_rad_s * time_s)
        pose[:3, :3] = rotation_from_vector(np.array([0.0, angle, 0.0]))
        pose[:3, 3] = self.place + self.sway * np.sin(self.phases_rad + self.rates_rad_s * time_s)
        return np.asarray(self.world_from_cam(frame) @ pose)


def moving_boards(
    setup: Setup,
    rng: np.random.Generator,
    world_from_cam: Callable[[float], Floats],
    quads: list[Quad],
    share: float,
    count: int,
    turn_deg_s: float,
) -> list[Quad]:
    """Make boards side by side that together cover a share of the view."""
    nearest = min(nearest_ahead(setup, quads, world_from_cam(float(frame))) for frame in _FRAMES)
    depth = _NEARER * nearest
    view = depth * np.array([setup.width / setup.K[0, 0], setup.height / setup.K[1, 1]])
    cell = view / [count, 1]
    side = np.sqrt(share) * cell
    if turn_deg_s > 0:
        side[0] = min(side[0] / _NARROWER, 0.98 * cell[0])
    painter = setup.painter(np.zeros(3), depth)
    painter.count = len(quads)
    boards = []
    for i in range(count):
        place = np.array([(i + 0.5) * cell[0] - 0.5 * view[0], 0.0, depth])
        sway = np.minimum(0.5 * _SWAY * (cell - side), _LARGEST_SWAY * view)
        motion = _BoardMotion(
            world_from_cam=world_from_cam,
            fps=setup.fps,
            place=place,
            # Towards the camera and back as well, by a tenth of the distance.
            sway=np.array([*sway, 0.05 * depth]),
            rates_rad_s=2 * np.pi * rng.uniform(*_SWAY_HZ, 3),
            phases_rad=rng.uniform(0, 2 * np.pi, 3),
            turn_rad=_TURN_RAD if turn_deg_s > 0 else 0.0,
            # The root mean square of the speed of A sin(w t) is A w / sqrt(2).
            turn_rate_rad_s=np.sqrt(2) * np.radians(turn_deg_s) / _TURN_RAD,
            turn_phase_rad=float(rng.uniform(0, 2 * np.pi)),
        )
        corner = np.array([-0.5 * side[0], -0.5 * side[1], 0.0])
        edges = np.array([side[0], 0.0, 0.0]), np.array([0.0, side[1], 0.0])
        painted = painter.quad(corner + np.array([0.0, 0.0, depth]), *edges, "print")
        boards.append(replace(painted, corner=corner, body=motion))
    return boards


def moving_cards(setup: Setup, path: Path, quads: list[Quad], share: float) -> list[Quad]:
    """Make boards that sway in front of the camera; together they cover about the given share of the image.

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


def nearest_ahead(setup: Setup, quads: Sequence[Quad], pose: Floats) -> float:
    """Compute the least depth of the scene along 7x7 rays spread over the view.

    Shapes: ``pose`` (4, 4).
    """
    x, y = np.meshgrid(np.linspace(0, setup.width - 1, 7), np.linspace(0, setup.height - 1, 7))
    rays = pose[:3, :3] @ np.linalg.inv(setup.K) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    depths = []
    for quad in quads:
        edges = np.column_stack([quad.edge_u, quad.edge_v])
        normal = np.cross(*edges.T)
        depth = (normal @ (quad.corner - pose[:3, 3])) / (normal @ rays)
        a, b = np.linalg.pinv(edges) @ (pose[:3, 3:] + depth * rays - quad.corner[:, None])
        depths.append(depth[(depth > 0) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)])
    return float(np.concatenate(depths).min())


# -- tag -------------------------------------------------------------------------------------------


#: Number of the tag in its family.
TAG_NUMBER = 7
# Cells of the tag with its black border, and of the white margin on each side.
_CELLS, _MARGIN = 8, 1
_CELL_TEXELS = 32
# Depth of the board over the least depth of the scene: the board intersects nothing.
_TAG_NEARER = 0.7
# Grey levels of the black and of the white print.
_BLACK, _WHITE = 30, 225
# The board is turned about its vertical axis, so that its size and its distance are distinguished.
_TAG_TURN_RAD = np.radians(20.0)


@dataclass(frozen=True, eq=False)
class TagTexture(Texture):
    """The texture of the board."""

    @cached_property
    def levels(self) -> list[Image]:
        """Images of the texture, each half as large as the one before.

        Shapes: returns (H, W, 3).
        """
        import cv2

        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        tag = cv2.aruco.generateImageMarker(dictionary, TAG_NUMBER, _CELLS * _CELL_TEXELS)
        margin = _MARGIN * _CELL_TEXELS
        printed = np.pad(np.where(tag > 0, _WHITE, _BLACK).astype(np.uint8), margin, constant_values=_WHITE)
        return halved(np.repeat(cv2.GaussianBlur(printed, (0, 0), 0.7)[:, :, None], 3, axis=2))


def tag_board(setup: Setup, world_from_cam: Callable[[float], Floats], quads: Sequence[Quad], side_m: float) -> Quad:
    """Make the board."""
    pose = world_from_cam(0.0)
    depth = _TAG_NEARER * nearest_ahead(setup, quads, pose)
    side = side_m * (_CELLS + 2 * _MARGIN) / _CELLS
    texels = (_CELLS + 2 * _MARGIN) * _CELL_TEXELS
    # The black square goes from the outer edge of its first texel to that of its last one; texel centres are half a
    # texel inside.
    half = 0.5 * side * (texels - 1) / texels
    c, s = np.cos(_TAG_TURN_RAD), np.sin(_TAG_TURN_RAD)
    u, v = 2 * half * np.array([c, 0.0, s]), 2 * half * np.array([0.0, 1.0, 0.0])
    corner = np.array([0.0, 0.0, depth]) - 0.5 * (u + v)
    R = pose[:3, :3]
    return Quad(R @ corner + pose[:3, 3], R @ u, R @ v, TagTexture((*setup.seed, 0), texels, texels, "wall"))
