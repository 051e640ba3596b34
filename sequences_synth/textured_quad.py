"""Textured parallelograms (quads). Every surface of a world is a quad."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.texture import Texture

# Largest side of a texture in texels: painting a larger one takes longer than rendering the sequence.
_MAX_TEXELS = 4096
# Direction towards the light: from above, and a little from the front left.
_SUN = np.array([-0.35, -0.5, 0.79])


@dataclass(frozen=True, eq=False)
class Quad:
    """A textured parallelogram ``corner + a edge_u + b edge_v``, a and b in [0, 1]."""

    #: corner, edge_u, edge_v: (3,) World frame, metres. Texel (s, t) lies at a = s / (width - 1), b = t / (height -
    #: 1).
    corner: Floats
    edge_u: Floats
    edge_v: Floats
    texture: Texture
    #: Factor on the texture's grey levels.
    light: float = 1.0
    #: If true, the quad is visible only where ``edge_u x edge_v`` points away from the camera, that is from the side
    #: from which u runs right and v runs down. Used for the faces of closed boxes.
    one_sided: bool = False
    #: For objects that move without turning: frame number -> displacement (3,) in metres.
    displacement: Callable[[float], Floats] | None = None
    #: For bodies that move and turn: frame number -> world_from_body (4, 4). Corner and edges are then in the frame
    #: of the body.
    body: Callable[[float], Floats] | None = None

    @property
    def moves(self) -> bool:
        """Whether the quad moves in the world."""
        return self.displacement is not None or self.body is not None

    def motion(self, frame: float, later: float) -> Floats:
        """Compute the motion of the quad from one frame to another.

        Shapes: returns (4, 4).

        * Returns: Maps world points on the quad at ``frame`` to where they are at ``later``, metres.
        """
        moved = np.eye(4)
        if self.body is not None:
            moved = self.body(later) @ np.linalg.inv(self.body(frame))
        elif self.displacement is not None:
            moved[:3, 3] = self.displacement(later) - self.displacement(frame)
        return np.asarray(moved)

    def corner_at(self, frame: float) -> Floats:
        """Compute the position of the corner at a frame.

        Shapes: returns (3,).
        """
        return self.corner if self.displacement is None else self.corner + self.displacement(frame)

    def world_from_texel(self, frame: float) -> Floats:
        """Compute the matrix that maps texels to world points.

        Shapes: returns (3, 3).

        * Returns: Its product with (s, t, 1) is the world point of texel (s, t), metres.
        """
        if self.body is not None:
            world_from_body = self.body(frame)
            columns = world_from_body[:3, :3] @ self._texel_frame
            return np.asarray(columns + np.outer(world_from_body[:3, 3], [0.0, 0.0, 1.0]))
        if self.displacement is None:
            return self._texel_frame
        return np.column_stack([self._texel_frame[:, :2], self.corner_at(frame)])

    @cached_property
    def texel_area(self) -> float:
        """Area of a texel in square metres."""
        return float(np.linalg.norm(np.cross(self._texel_frame[:, 0], self._texel_frame[:, 1])))

    @cached_property
    def _texel_frame(self) -> Floats:
        u = self.edge_u / (self.texture.width - 1)
        v = self.edge_v / (self.texture.height - 1)
        return np.column_stack([u, v, self.corner])


@dataclass(eq=False)
class Painter:
    """Makes quads. All textures are different, and each is as fine as the distance of the camera requires."""

    #: Entropy of the world; each texture adds its number.
    seed: tuple[int, ...]
    #: Focal length of the camera in pixels.
    focal_px: float
    #: (3,) Approximate position of the camera in the world, metres.
    viewpoint: Floats
    #: Least distance between the camera and any surface, metres.
    nearest_m: float
    #: Number of textures made so far.
    count: int = 0

    def quad(
        self,
        corner: Floats,
        edge_u: Floats,
        edge_v: Floats,
        look: str,
        light: float = 1.0,
        one_sided: bool = False,
        displacement: Callable[[float], Floats] | None = None,
        nearest_m: float = 0.0,
    ) -> Quad:
        """Make a quad with its own texture, of about 1.1 texels per pixel where it is nearest to the viewpoint.

        Shapes: ``corner, edge_u, edge_v`` (3,).

        * ``nearest_m``: For a quad whose nearest part is never in view: the least distance of its visible part, metres.
        """
        corner, edge_u, edge_v = (np.asarray(x, float) for x in (corner, edge_u, edge_v))
        grid = np.linspace(0, 1, 9)
        a, b = (x.ravel()[:, None] for x in np.meshgrid(grid, grid))
        distance = np.linalg.norm(corner + a * edge_u + b * edge_v - self.viewpoint, axis=1).min()
        density = 1.1 * self.focal_px / max(float(distance), self.nearest_m, nearest_m)
        width, height = (
            int(np.clip(round(density * float(np.linalg.norm(edge))), 24, _MAX_TEXELS)) for edge in (edge_u, edge_v)
        )
        texture = Texture((*self.seed, self.count), width, height, look)
        self.count += 1
        return Quad(corner, edge_u, edge_v, texture, light, one_sided, displacement)


def box(
    painter: Painter, centre: Floats, size: Floats, yaw_rad: float, look: str, floating: bool = False
) -> list[Quad]:
    """Make the faces of an upright box: four sides and the top.

    Shapes: ``centre`` (3,), ``size`` (3,).
    """
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = size[0] * np.array([c, s, 0]), size[1] * np.array([-s, c, 0]), size[2] * np.array([0, 0, 1.0])
    corner = np.asarray(centre, float) - 0.5 * x - 0.5 * y
    # Seen from outside, u runs right and v runs down.
    faces = [
        (corner + z, x, -z), (corner + x + z, y, -z), (corner + x + y + z, -x, -z), (corner + y + z, -y, -z),
        (corner + y + z, x, -y),
    ]  # fmt: skip
    if floating:
        faces.append((corner, x, y))
    quads = []
    for start, u, v in faces:
        outwards = -np.cross(u, v) / np.linalg.norm(np.cross(u, v))
        light = 0.78 + 0.22 * float(outwards @ _SUN)
        quads.append(painter.quad(start, u, v, look, light, one_sided=True))
    return quads
