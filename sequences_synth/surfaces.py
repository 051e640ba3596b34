"""The surfaces of scenes: what paints them, boxes, and the walls, pictures and furniture of rooms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.options import SynthOptions
from sequences_synth.texture import Quad, Texture

# Largest side of a texture in texels: painting a larger one takes longer than rendering the sequence.
_MAX_TEXELS = 4096
# Direction towards the light: from above, and a little from the front left.
_SUN = np.array([-0.35, -0.5, 0.79])


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

    def random_sign(self) -> float:
        """Draw a sign."""
        return float(self.rng.choice([-1.0, 1.0]))


@dataclass(eq=False)
class Painter:
    """Makes quads. All textures are different, and each is as fine as the distance of the camera requires."""

    #: Each texture adds its number to the entropy. The textures suit the camera.
    setup: Setup
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
        density = 1.1 * float(self.setup.K[0, 0]) / max(float(distance), self.nearest_m, nearest_m)
        width, height = (
            int(np.clip(round(density * float(np.linalg.norm(edge))), 24, _MAX_TEXELS)) for edge in (edge_u, edge_v)
        )
        texture = Texture((*self.setup.seed, self.count), width, height, look)
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


# -- the surfaces of rooms -------------------------------------------------------------------------


# A standing person who looks about level sees no floor nearer than this.
_LEVEL_GAZE_M = 2.0


def furnished_room(setup: Setup, viewpoint: Floats) -> list[Quad]:
    """Build walls, pictures and boxes around a viewpoint that looks along y. No object is near the camera.

    Shapes: ``viewpoint`` (3,).
    """
    rng = setup.rng
    painter = Painter(setup, viewpoint, 1.3)
    left, right = -rng.uniform(2.3, 3.4), rng.uniform(2.3, 3.4)
    front, back, top = rng.uniform(4.2, 6.5), -rng.uniform(1.6, 2.5), rng.uniform(2.5, 3.0)
    quads = _shell(painter, rng, left, right, back, front, top)
    quads += _pictures(painter, rng, left, right, front, top)
    for _ in range(int(rng.integers(9, 15))):
        size = np.array([rng.uniform(0.3, 1.1), rng.uniform(0.3, 0.9), rng.uniform(0.3, 1.3)])
        y = rng.uniform(1.9, front - 0.4)
        # Near objects are low: high ones would hide the room.
        size[2] = min(size[2], 0.35 + 0.3 * y)
        x = rng.uniform(left + 0.4, right - 0.4)
        look = str(rng.choice(["print", "print", "wood", "wall"]))
        quads += box(painter, np.array([x, y, 0.0]), size, rng.uniform(-0.8, 0.8), look)
    return quads


def _shell(
    painter: Painter, rng: np.random.Generator, left: float, right: float, back: float, front: float, top: float
) -> list[Quad]:
    """Floor, ceiling and four walls, each 2 cm too large on every side, so that no ray passes through a corner."""
    m = 0.02
    w, d, h = right - left + 2 * m, front - back + 2 * m, top + 2 * m
    x, y, z = np.array([w, 0, 0]), np.array([0, d, 0]), np.array([0, 0, h])
    lights = rng.uniform(0.75, 1.0, 4)
    return [
        painter.quad(np.array([left - m, front, top + m]), x, -z, "wall", lights[0]),
        painter.quad(np.array([right + m, back, top + m]), -x, -z, "wall", lights[1]),
        painter.quad(np.array([left, back - m, top + m]), y, -z, "wall", lights[2]),
        painter.quad(np.array([right, front + m, top + m]), -y, -z, "wall", lights[3]),
        painter.quad(np.array([left - m, front + m, 0]), x, -y, "wood", 0.9, nearest_m=_LEVEL_GAZE_M),
        painter.quad(np.array([left - m, back - m, top]), x, y, "ceiling", 0.85, nearest_m=_LEVEL_GAZE_M),
    ]


def _pictures(
    painter: Painter, rng: np.random.Generator, left: float, right: float, front: float, top: float
) -> list[Quad]:
    """Pictures and cupboards on the far and the side walls."""
    quads = []
    down = np.array([0, 0, -1.0])
    for _ in range(int(rng.integers(4, 7))):
        w, h, off = rng.uniform(0.5, 1.2), rng.uniform(0.4, 0.9), rng.uniform(0.02, 0.3)
        corner = np.array([rng.uniform(left + 0.1, right - w - 0.1), front - off, rng.uniform(1.2, top - 0.1)])
        quads.append(painter.quad(corner, np.array([w, 0, 0]), h * down, "print", rng.uniform(0.8, 1.05)))
    for side, x in ((1, left), (-1, right)):
        for _ in range(2):
            w, h, off = rng.uniform(0.6, 1.2), rng.uniform(0.4, 0.9), rng.uniform(0.02, 0.25)
            y = rng.uniform(1.5, front - w)
            start = y if side > 0 else y + w
            corner = np.array([x + side * off, start, rng.uniform(1.2, top - 0.1)])
            quads.append(painter.quad(corner, np.array([0, side * w, 0]), h * down, "print", rng.uniform(0.7, 0.95)))
    return quads


def corridor_walls(painter: Painter, rng: np.random.Generator, half: float, top: float, length: float) -> list[Quad]:
    """Walls, floor and ceiling in panels, with some door frames between them.

    Each panel has a texture as fine as its distance requires.
    """
    quads = []
    x, z, m = np.array([2 * half + 0.04, 0, 0]), np.array([0, 0, top + 0.04]), 0.02
    y0 = -2.0
    while y0 < length:
        step = rng.uniform(1.5, 2.6)
        y, lights = np.array([0, step + 0.01, 0]), rng.uniform(0.75, 1.0, 4)
        quads += [
            painter.quad(np.array([-half, y0, top + m]), y, -z, "wall", lights[0]),
            painter.quad(np.array([half, y0 + step, top + m]), -y, -z, "wall", lights[1]),
            painter.quad(np.array([-half - m, y0 + step, 0]), x, -y, "wood", lights[2]),
            painter.quad(np.array([-half - m, y0, top]), x, y, "ceiling", 0.9 * lights[3]),
        ]
        y0 += step
        if y0 > 2.5 and rng.random() < 0.6:
            depth, width = 0.2, rng.uniform(0.1, 0.25)
            for side in (-1, 1):
                post = np.array([side * (half - 0.5 * width), y0, 0])
                quads += box(painter, post, np.array([width, depth, top]), 0.0, "wood")
            lintel = np.array([0, y0, top - 0.3])
            quads += box(painter, lintel, np.array([2 * half, depth, 0.32]), 0.0, "wood", floating=True)
    quads.append(painter.quad(np.array([-half - m, length, top + m]), x, -z, "print", 0.9))
    return quads
