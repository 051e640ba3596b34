"""A tag of known size in a scene: an AprilTag of the family 36h11, on a board that faces the camera at first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sequences_synth.boards import nearest_ahead
from sequences_synth.builder import Setup
from sequences_synth.texture import Texture, halved
from sequences_synth.textured_quad import Quad

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Number of the tag in its family.
TAG_NUMBER = 7
# Cells of the tag with its black border, and of the white margin on each side.
_CELLS, _MARGIN = 8, 1
_CELL_TEXELS = 32
# Depth of the board over the least depth of the scene: the board intersects nothing.
_NEARER = 0.7
# Grey levels of the black and of the white print.
_BLACK, _WHITE = 30, 225
# The board is turned about its vertical axis, so that its size and its distance are distinguished.
_TURN_RAD = np.radians(20.0)


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
    depth = _NEARER * nearest_ahead(setup, quads, pose)
    side = side_m * (_CELLS + 2 * _MARGIN) / _CELLS
    texels = (_CELLS + 2 * _MARGIN) * _CELL_TEXELS
    # The black square goes from the outer edge of its first texel to that of its last one; texel centres are half a
    # texel inside.
    half = 0.5 * side * (texels - 1) / texels
    c, s = np.cos(_TURN_RAD), np.sin(_TURN_RAD)
    u, v = 2 * half * np.array([c, 0.0, s]), 2 * half * np.array([0.0, 1.0, 0.0])
    corner = np.array([0.0, 0.0, depth]) - 0.5 * (u + v)
    R = pose[:3, :3]
    return Quad(R @ corner + pose[:3, 3], R @ u, R @ v, TagTexture((*setup.seed, 0), texels, texels, "wall"))
