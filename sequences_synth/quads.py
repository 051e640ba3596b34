"""Textured parallelograms (quads): every surface of a world is one. What the builders of all scenes share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.options import SynthOptions
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

    @cached_property
    def world_from_texel(self) -> Floats:
        """(3, 3) whose product with (s, t, 1) is the world point of texel (s, t), metres."""
        u = self.edge_u / (self.texture.width - 1)
        v = self.edge_v / (self.texture.height - 1)
        return np.column_stack([u, v, self.corner])

    @cached_property
    def texel_area(self) -> float:
        """Area of a texel in square metres."""
        return float(np.linalg.norm(np.cross(self.world_from_texel[:, 0], self.world_from_texel[:, 1])))


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
        return Quad(corner, edge_u, edge_v, texture, light, one_sided)


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


@dataclass(frozen=True, eq=False)
class Setup:
    """Input of every scene builder: the random generator and the camera."""

    #: Source of all draws of the scene.
    rng: np.random.Generator
    #: Entropy of the scene, from which the textures are seeded.
    seed: tuple[int, ...]
    #: (3, 3) True calibration matrix, pixels.
    K: Floats
    options: SynthOptions

    def painter(self, viewpoint: Floats, nearest_m: float) -> Painter:
        """Make a painter whose textures suit this camera.

        Shapes: ``viewpoint`` (3,).
        """
        return Painter(self.seed, float(self.K[0, 0]), viewpoint, nearest_m)

    def random_sign(self) -> float:
        """Draw a sign."""
        return float(self.rng.choice([-1.0, 1.0]))
