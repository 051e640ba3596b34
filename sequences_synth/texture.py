"""Procedural textures: 1/f noise under shapes, lines and letters of many sizes; and the quads that they cover.

Feature detectors need corners at every scale at which a surface may be seen. Therefore the sizes of the marks follow a
power law. Matchers need each corner to look different from its neighbours. Therefore no texture is tiled. Every
surface of a world is a textured parallelogram (quad).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from sequences_synth.arrays import Floats, Floats32, Image

Color = tuple[float, float, float]

# Average number of texels per mark: with about one texel per pixel, an image of 640x480 shows some 700 marks.
_TEXELS_PER_MARK = 450
# Smallest and largest radius of a mark in texels.
_RADII = (2.0, 140.0)
# Marks are painted at positions with 4 binary places below the texel.
_SHIFT = 4
_GLYPHS = "ABCDEFGHJKLMNPQRSTUVWXYZ0123456789&%?#@"


@dataclass(frozen=True)
class Look:
    """Appearance of a kind of surface."""

    #: One of them, chosen at random, is the ground colour of a surface.
    base: tuple[Color, ...]
    #: Each mark has one of these colours, changed a little at random.
    accents: tuple[Color, ...]
    #: Standard deviation of the 1/f noise in grey levels.
    clouds: float
    #: Standard deviation of the texel-to-texel noise in grey levels.
    grain: float
    #: Relative frequency of each of :data:`_MARKS`.
    marks: tuple[int, ...]
    #: Colour of a mark between the ground colour (0) and the accent (1): high for prints, low for stains.
    blend: float
    #: Size in texels of patches of different colour under the marks, like fields seen from above; 0 for none.
    patch_texels: int = 0


_MARKS = ("rectangle", "ellipse", "polygon", "line", "glyph")

# Ground colours.
_PLASTER = ((170, 190, 200), (185, 180, 165), (165, 185, 170), (150, 165, 190))
_PAPER = ((225, 230, 232), (120, 80, 50), (60, 75, 150), (70, 110, 80), (50, 140, 190))
_TABLE = ((95, 120, 150), (110, 115, 120), (80, 105, 140), (125, 140, 150))
_PLANKS = ((70, 110, 155), (85, 120, 150), (60, 90, 130), (110, 140, 170))
_WHITE = ((205, 210, 212), (190, 200, 205))
_GRASS = ((70, 115, 105), (85, 120, 130), (75, 105, 90))
# Colours of marks.
_PRINTS = (
    (45, 45, 50), (60, 60, 170), (150, 80, 40), (70, 130, 60), (40, 150, 205), (215, 225, 230), (130, 120, 110),
    (95, 70, 130), (190, 175, 150), (30, 70, 110),
)  # fmt: skip
_GRAINS = ((30, 50, 80), (130, 175, 215), (45, 70, 105), (200, 210, 215), (50, 50, 60))
_STAINS = ((120, 125, 130), (230, 235, 238), (90, 100, 120), (150, 165, 180))
_FIELDS = (
    (40, 75, 50), (60, 105, 75), (120, 150, 165), (165, 175, 180), (80, 95, 150), (95, 100, 105), (90, 140, 160),
    (35, 60, 45), (205, 210, 215),
)  # fmt: skip

#: Looks by name.
LOOKS = {
    "wall": Look(_PLASTER, _PRINTS, clouds=16, grain=5, marks=(4, 2, 3, 1, 4), blend=0.6),
    "print": Look(_PAPER, _PRINTS, clouds=10, grain=4, marks=(4, 3, 3, 1, 8), blend=0.9),
    "desk": Look(_TABLE, _PRINTS, clouds=14, grain=5, marks=(6, 2, 2, 1, 7), blend=0.85, patch_texels=260),
    "wood": Look(_PLANKS, _GRAINS, clouds=20, grain=6, marks=(3, 4, 4, 2, 1), blend=0.55),
    "ceiling": Look(_WHITE, _STAINS, clouds=12, grain=4, marks=(4, 2, 3, 2, 0), blend=0.6),
    "ground": Look(_GRASS, _FIELDS, clouds=22, grain=7, marks=(3, 6, 4, 1, 0), blend=0.75, patch_texels=170),
}


@dataclass(frozen=True, eq=False)
class Texture:
    """A texture that is painted at its first use; the result depends on the seed only."""

    #: Entropy of this texture only.
    seed: Sequence[int]
    #: width, height: Size in texels.
    width: int
    height: int
    #: Key of :data:`LOOKS`.
    look: str

    @cached_property
    def levels(self) -> list[Image]:
        """Images of the texture, each half as large as the one before.

        Shapes: returns (H, W, 3).
        """
        return halved(_paint(np.random.default_rng(list(self.seed)), self.height, self.width, LOOKS[self.look]))


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


def halved(image: Image) -> list[Image]:
    """Halve an image again and again.

    Shapes: ``image`` (H, W, 3), returns (H, W, 3).

    * Returns: The image first. Texel s of level 0 lies at s / 2^k of level k.
    """
    import cv2

    # pyrDown maps texel 2 s to s, so that a level only scales the coordinates, without a shift by half a texel.
    levels = [image]
    while min(levels[-1].shape[:2]) > 8:
        levels.append(cast(Image, cv2.pyrDown(levels[-1])))
    return levels


def _paint(rng: np.random.Generator, height: int, width: int, look: Look) -> Image:
    """Paint one surface, (height, width, 3) uint8 BGR."""
    import cv2

    base = np.asarray(look.base[rng.integers(len(look.base))]) + rng.normal(0, 8) + rng.normal(0, 4, 3)
    clouds = _fractal_noise(rng, height, width, octaves=8)
    clouds *= look.clouds
    ground = base.astype(np.float32)
    if look.patch_texels:
        ground = ground + _patches(rng, height, width, look)
    channel = np.empty_like(clouds)  # one buffer for all: arrays of this size are dear to allocate
    channels = []
    for i in range(3):
        np.clip(np.add(clouds, ground[..., i], out=channel), 0, 255, out=channel)
        channels.append(channel.astype(np.uint8))
    canvas = cast(Image, cv2.merge(channels))
    _draw_marks(rng, canvas, base, look)
    # A lens blurs every edge, and bilinear sampling is accurate only on smooth textures.
    canvas = cast(Image, cv2.GaussianBlur(canvas, (0, 0), 0.7))
    grain = _fractal_noise(rng, height, width, octaves=3)
    grain *= look.grain
    grained = [cv2.add(channel, grain, dtype=cv2.CV_8U) for channel in cv2.split(canvas)]  # saturates
    return cast(Image, cv2.merge(grained))


def _patches(rng: np.random.Generator, height: int, width: int, look: Look) -> Floats32:
    """(height, width, 3) colour offsets, constant on irregular patches: the cells of random points."""
    import cv2

    step = 4  # patches are computed at a quarter of the resolution: their outlines need not be sharp
    rows, columns = -(-height // step), -(-width // step)
    count = max(2, height * width // look.patch_texels**2)
    points = rng.random((count, 2)) * (columns, rows)
    accents = np.asarray(look.accents)[rng.integers(len(look.accents), size=count)] - np.asarray(look.base[0])
    offsets = (0.45 * accents + rng.normal(0, 12, (count, 1)) + rng.normal(0, 4, (count, 3))).astype(np.float32)
    y, x = np.mgrid[:rows, :columns].astype(np.float32)
    # The noise bends the borders, as straight ones look artificial.
    x += 4 * _fractal_noise(rng, rows, columns, octaves=5)
    nearest = np.full((rows, columns), np.inf, np.float32)
    cells = np.zeros((rows, columns), np.intp)
    for i, (px, py) in enumerate(points.astype(np.float32)):
        distance = np.abs(x - px) + np.abs(y - py)
        closer = distance < nearest
        nearest[closer], cells[closer] = distance[closer], i
    return cast(Floats32, cv2.resize(offsets[cells], (width, height), interpolation=cv2.INTER_LINEAR))


def _fractal_noise(rng: np.random.Generator, height: int, width: int, octaves: int) -> Floats32:
    """(height, width) noise of unit variance whose amplitude grows with the wavelength, from 2 texels up."""
    import cv2

    noise: Floats32 = np.zeros((1, 1), np.float32)
    for octave in reversed(range(octaves)):
        shape = (-(-height // 2**octave) + 1, -(-width // 2**octave) + 1)
        detail = rng.standard_normal(shape, np.float32)
        detail *= 1.4**octave
        detail += cast(Floats32, cv2.resize(noise, shape[::-1], interpolation=cv2.INTER_LINEAR))
        noise = detail
    noise = noise[:height, :width]
    noise /= np.float32(max(float(noise.std()), 1e-6))
    return noise


def _draw_marks(rng: np.random.Generator, canvas: Image, base: NDArray[np.float64], look: Look) -> None:
    """Draw marks of all sizes, large ones first."""
    height, width = canvas.shape[:2]
    count = max(12, height * width // _TEXELS_PER_MARK)
    largest = min(_RADII[1], 0.3 * min(height, width))
    # The density of the radii is proportional to r^-2.6: each finer octave has many more marks, of a little less area.
    low, high = _RADII[0] ** -1.6, max(largest, _RADII[0] + 1) ** -1.6
    radii = np.sort((low + rng.random(count) * (high - low)) ** (-1 / 1.6))[::-1]
    centres = rng.random((count, 2)) * (width, height)
    angles = rng.uniform(0, np.pi, count)
    kinds = rng.choice(_MARKS, count, p=np.array(look.marks) / sum(look.marks))
    accents = np.asarray(look.accents)[rng.integers(len(look.accents), size=count)]
    colors = np.clip(base + look.blend * (accents - base) + rng.normal(0, 12, (count, 3)), 0, 255)
    marks = (kinds.tolist(), centres.tolist(), radii.tolist(), angles.tolist(), colors.tolist())
    for kind, centre, radius, angle, color in zip(*marks, strict=True):
        _draw_mark(rng, canvas, kind, centre, radius, angle, color)


def _draw_mark(
    rng: np.random.Generator,
    canvas: Image,
    kind: str,
    centre: list[float],
    radius: float,
    angle: float,
    color: list[float],
) -> None:
    """Draw one mark with anti-aliased edges. A picture has thousands, so that single numbers are no arrays here."""
    import cv2

    x, y = centre
    if kind == "glyph" and radius > 4:
        text = "".join(_GLYPHS[i] for i in rng.integers(len(_GLYPHS), size=rng.integers(1, 5)).tolist())
        scale = min(radius, 60.0) / 22
        thickness = max(1, round(scale * 2.2))
        cv2.putText(canvas, text, (int(x), int(y)), int(rng.integers(0, 5)), scale, color, thickness, cv2.LINE_AA)
        return
    if kind == "line":
        across, down = 3 * radius * math.cos(angle), 3 * radius * math.sin(angle)
        first, last = _fixed([(x - across, y - down), (x + across, y + down)])
        cv2.line(canvas, first, last, color, max(1, round(radius / 12)), cv2.LINE_AA, _SHIFT)
        return
    if kind == "ellipse":
        middle, axes = _fixed([(x, y), (radius * _share(rng, 0.5), radius * _share(rng, 0.5))])
        cv2.ellipse(canvas, middle, axes, math.degrees(angle), 0, 360, color, -1, cv2.LINE_AA, _SHIFT)
        return
    if kind == "polygon":
        turns = [angle + turn for turn in sorted(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 7))).tolist())]
        reaches = [radius * _share(rng, 0.6) for _ in turns]
        corners = [(r * math.cos(turn), r * math.sin(turn)) for r, turn in zip(reaches, turns, strict=True)]
    else:
        # Rectangles, and glyphs too small to be letters. Six of ten are nearly upright, as man-made objects are.
        tilt = rng.normal(0, 0.05) if rng.random() < 0.6 else angle
        a, b = radius * _share(rng, 0.3), radius * _share(rng, 0.3)
        cosine, sine = math.cos(tilt), math.sin(tilt)
        upright = ((-a, -b), (a, -b), (a, b), (-a, b))
        corners = [(u * cosine - v * sine, u * sine + v * cosine) for u, v in upright]
    points = np.array(_fixed([(x + u, y + v) for u, v in corners]), np.int32)
    cv2.fillPoly(canvas, [points], color, cv2.LINE_AA, _SHIFT)


def _share(rng: np.random.Generator, low: float) -> float:
    """Draw a number from ``low`` to 1."""
    return low + (1 - low) * rng.random()


def _fixed(points: Sequence[tuple[float, float]]) -> list[tuple[int, int]]:
    """Convert points to the fixed-point numbers of OpenCV."""
    return [(round(x * 2**_SHIFT), round(y * 2**_SHIFT)) for x, y in points]
