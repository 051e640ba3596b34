"""Two-view scenes as matched bearings: general, planar, nearly planar, forward, with little parallax and without.

A camera of 640x480 px with a focal length of 458 px sees points. Pixels are only the unit of the noise and of the field
of view. The second camera is rotated by 4 degrees about a random axis and moved by a given share of the median depth.
Both images have Gaussian noise; an outlier has its true place in image 1 and a random place in image 2.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import rotation_from_vector

Floats = NDArray[np.float64]

#: ``(rng, rays) -> depths (N,)``: z of the points on the rays (N, 3) with z = 1, negative where there is none.
Surface = Callable[[np.random.Generator, Floats], Floats]

FOCAL_PX = 458.0
_WIDTH_PX, _HEIGHT_PX = 640.0, 480.0
_CENTRE_PX = np.array([_WIDTH_PX / 2, _HEIGHT_PX / 2])
_TURN_RAD = np.deg2rad(4.0)
#: Distance of planes; with depths of 1 to 4 elsewhere the median depth is about the same.
_PLANE_DISTANCE = 2.0
#: Rays that meet a plane at a smaller angle are left out, as if the plane ended there.
_LEAST_COSINE = 0.15
#: Points are sampled until enough are in both images, at most in this number of rounds.
_MAX_ROUNDS = 50


@dataclass(frozen=True, eq=False)
class Scene:
    """Matches of two views, and the true motion: ``u R m + t = v n`` up to noise and outliers."""

    #: bearings1, bearings2: (N, 3) Unit rays, noisy.
    bearings1: Floats
    bearings2: Floats
    #: (3, 3)
    R: Floats
    #: (3,) Translation of cam2_from_cam1: of norm 1, or zero for a rotation-only camera.
    t: Floats
    #: (N,)
    inliers: NDArray[np.bool_]


@dataclass(frozen=True)
class SceneKind:
    """A kind of scene to draw."""

    #: ``rng -> Surface``: draws the shape of a world.
    surface: Callable[[np.random.Generator], Surface]
    #: ``rng -> (3,)``: where camera 2 stands, of any norm.
    direction: Callable[[np.random.Generator], Floats]
    #: Its distance in units of the median depth.
    baseline: float


def draw_scene(
    kind: SceneKind, rng: np.random.Generator, *, matches: int, outlier_share: float, noise_px: float
) -> Scene:
    """Draw a scene.

    * ``outlier_share``: Share of them that are outliers, rounded to the nearest whole number of matches.
    """
    axis = rng.normal(size=3)
    R = rotation_from_vector(_TURN_RAD * axis / np.linalg.norm(axis))
    direction = kind.direction(rng)
    surface = kind.surface(rng)
    depths = surface(rng, _rays(_pixels(rng, 2000)))
    centre = kind.baseline * np.median(depths[depths > 0]) * direction / np.linalg.norm(direction)

    kept: list[tuple[Floats, Floats]] = []
    count = 0
    for _ in range(_MAX_ROUNDS):
        pixels1 = _pixels(rng, 2 * matches)
        rays = _rays(pixels1)
        depths = surface(rng, rays)
        seen = (rays * depths[:, None] - centre) @ R.T
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels2 = FOCAL_PX * seen[:, :2] / seen[:, 2:] + _CENTRE_PX
        inside = (pixels2 >= 0).all(axis=1) & (pixels2 <= (_WIDTH_PX, _HEIGHT_PX)).all(axis=1)
        use = (depths > 0) & (seen[:, 2] > 0.1) & inside
        kept.append((pixels1[use], pixels2[use]))
        count += int(use.sum())
        if count >= matches:
            break
    else:
        raise ValueError(f"{count} of {matches} points are in both images: give a shorter baseline")
    pixels1, pixels2 = (np.concatenate(parts)[:matches] for parts in zip(*kept, strict=True))
    pixels1 = pixels1 + noise_px * rng.normal(size=pixels1.shape)
    pixels2 = pixels2 + noise_px * rng.normal(size=pixels2.shape)
    inliers = np.ones(matches, bool)
    inliers[rng.permutation(matches)[: round(outlier_share * matches)]] = False
    pixels2[~inliers] = _pixels(rng, int((~inliers).sum()))
    length = float(np.linalg.norm(centre))
    return Scene(_unit(_rays(pixels1)), _unit(_rays(pixels2)), R, -R @ centre / (length or 1.0), inliers)


def _pixels(rng: np.random.Generator, count: int) -> Floats:
    """Places (count, 2), uniform over the image."""
    return rng.uniform((0, 0), (_WIDTH_PX, _HEIGHT_PX), (count, 2))


def _rays(pixels: Floats) -> Floats:
    return np.column_stack([(pixels - _CENTRE_PX) / FOCAL_PX, np.ones(len(pixels))])


def _unit(rays: Floats) -> Floats:
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


# -- surfaces and directions of motion ------------------------------------------------------------


def _volume(rng: np.random.Generator) -> Surface:
    """Depths of 1 to 4, independent of one another."""
    return lambda rng, rays: rng.uniform(1, 4, len(rays))


def _plane_of(normal: Floats, distance: float, rays: Floats) -> Floats:
    cosine = rays @ normal
    return np.where(cosine > _LEAST_COSINE, distance / np.maximum(cosine, _LEAST_COSINE), -1.0)


def _plane(slope: float) -> Callable[[np.random.Generator], Surface]:
    """A plane whose normal has slopes of up to ``slope`` in x and y; without slope it is parallel to the image."""

    def draw(rng: np.random.Generator) -> Surface:
        normal = np.array([*rng.uniform(-slope, slope, 2), 1.0])
        normal /= np.linalg.norm(normal)
        return lambda rng, rays: _plane_of(normal, _PLANE_DISTANCE, rays)

    return draw


def _desk(rng: np.random.Generator) -> Surface:
    """A plane seen at a slant, 60 to 90 % of the points on it, the others on four boxes of different heights.

    A box is a round patch of the image, 80 px wide; its points lie between 0.3 and 1 of its height (top and sides), and
    the height is 0.1 to 0.4 of the plane's distance.
    """
    normal = np.array([rng.uniform(-0.2, 0.2), rng.uniform(0.3, 0.7), 1.0])
    normal /= np.linalg.norm(normal)
    share = rng.uniform(0.1, 0.4)
    middles, heights = _rays(_pixels(rng, 4))[:, :2], rng.uniform(0.1, 0.4, 4)

    def surface(rng: np.random.Generator, rays: Floats) -> Floats:
        offset = np.linalg.norm(rays[:, None, :2] - middles, axis=2)
        box = np.argmin(offset, axis=1)
        on_box = offset.min(axis=1) < 40 / FOCAL_PX
        depths = _plane_of(normal, _PLANE_DISTANCE, rays)
        raised = 1 - heights[box] * rng.uniform(0.3, 1, len(rays))
        # Boxes have many features: points of the plane are dropped until the requested share is reached.
        plane_kept = on_box.mean() * (1 - share) / (share * max((~on_box).mean(), 1e-9))
        dropped = ~on_box & (rng.random(len(rays)) > plane_kept)
        return np.where(dropped, -1.0, np.where(on_box, depths * raised, depths))

    return surface


def _anywhere(rng: np.random.Generator) -> Floats:
    return rng.normal(size=3)


def _level(rng: np.random.Generator) -> Floats:
    """Along the image, as a camera that looks straight down in level flight."""
    return np.array([*rng.normal(size=2), 0.0])


def _climbing(rng: np.random.Generator) -> Floats:
    """Up or down by 15 to 60 degrees from level."""
    heading, climb = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(15, 60)) * rng.choice([-1, 1])
    return np.array([np.cos(climb) * np.cos(heading), np.cos(climb) * np.sin(heading), np.sin(climb)])


def _forward(rng: np.random.Generator) -> Floats:
    return np.array([0.0, 0.0, 1.0]) + 0.05 * rng.normal(size=3)


#: The scenes of the comparison. A baseline of .15 is that of a keyframe, .03 that of video after a few frames; at .01
#: the median match moves by 5 px, at a noise of about 1.
SCENES: dict[str, SceneKind] = {
    "general .15": SceneKind(_volume, _anywhere, 0.15),
    "general .03": SceneKind(_volume, _anywhere, 0.03),
    "plane .15": SceneKind(_plane(0.7), _anywhere, 0.15),
    "plane .05": SceneKind(_plane(0.7), _anywhere, 0.05),
    "nadir level .15": SceneKind(_plane(0.0), _level, 0.15),
    "nadir climbing .15": SceneKind(_plane(0.0), _climbing, 0.15),
    "desk .15": SceneKind(_desk, _anywhere, 0.15),
    "forward .15": SceneKind(_volume, _forward, 0.15),
    "low parallax .01": SceneKind(_volume, _anywhere, 0.01),
    "rotation": SceneKind(_volume, _anywhere, 0.0),
}
