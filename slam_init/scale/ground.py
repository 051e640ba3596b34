"""The ground plane below the camera, in the landmarks of a map.

A monocular map does not know the direction of gravity. The ground is taken to be the plane below the camera with the
most significant number of inliers, with nothing beneath it. Below is the direction of the lower border of the image,
for a camera that is held as cameras are held: rolled by at most 15 degrees, and tilted by at most 45 degrees, at which
a wall is as near to that direction as the ground.

**A plane is linear in inverse depths.** For a landmark seen along the ray ``(x, y, 1)`` of the first camera, the plane
``k . X = 1`` predicts the inverse depth ``k . (x, y, 1)``. The standard deviation of an inverse depth hardly depends on
the depth, so that near and far landmarks count as they should.

**Significance.** A plane can be laid through any cloud of points. So the number of its inliers is compared with the
number expected without a plane: an a-contrario rule [1]_. Each ray that meets the plane has its own chance, which is
large near the horizon, where all depths agree with a plane. Below a camera, the chance is that of a depth of another
landmark. Ahead of a camera that looks down, all depths of a plane are alike, and the chance is that of any depth from
half of that of the plane on. The probability of the number of inliers is bounded by that of a Poisson distribution
(Chernoff), and multiplied by the number of planes through three landmarks. The slopes that the ground may have are
those for which its inliers are most significant.

**Uncertainty.** A road has a camber, a curb and a lawn. Their heights are alike for all landmarks of a place, so that
the number of landmarks says nothing. The standard deviation is that of a jackknife over nine parts of the ground.

References
----------
.. [1] L. Moisan, B. Stival, A probabilistic criterion to detect rigid point matches between two images and estimate the
   fundamental matrix, IJCV 2004.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slam_init.bundle.least_squares import CAUCHY
from slam_init.scale.requests import NoScaleError
from slam_init.scale.sensitivity import InverseDepths, inverse_depths
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.initial_map import InitialMap

#: Heights of the ground under the landmarks, as share of the height of the camera: 3 cm below a car's camera.
_ROUGHNESS = 0.02
#: Slopes of the ground in radians: a floor, a road, a lawn. The second one is used to look for a plane.
_WAVES_RAD = tuple(math.radians(angle) for angle in (0.05, 0.25, 0.5))
_FIRST_WAVES_RAD = _WAVES_RAD[1]
#: The height is known no better than this share of it: a curb or a lawn of 12 cm beside a road, seen from 1.65 m.
_LEAST_SIGMA = 0.08
#: Inliers lie within this number of standard deviations.
_SIGMAS = 3.0
#: Number of planes through three landmarks, most of which do not lie below the camera. Where a tenth of the landmarks
#: lies on the ground, all of them miss it with a probability of 1e-9.
_SAMPLES = 20_000
#: Of them, so many that lie in the expected direction are looked at.
_CANDIDATES = 2000
#: Expected number of planes with as many inliers in a scene without a plane.
_FALSE_ALARMS = 1e-3
#: Nothing lies beneath the ground but reflections and wrong depths: at most this share of the number of its inliers.
_BENEATH = 0.2
#: How cameras are held, as sines and cosines of the angles in the module docstring.
_MOST_ROLL, _LEAST_COSINE = math.sin(math.radians(15)), math.cos(math.radians(45))
_REFINEMENTS = 10
#: Parts of the ground in each of two directions, for the jackknife.
_PARTS = 3


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground plane."""

    #: Height of the camera above it in units of the map, on average over the keyframes.
    height: float
    #: Variance of the logarithm of the height for given poses.
    variance: float
    #: Derivatives of the logarithm by the poses of the keyframes.
    by_poses: Floats
    #: Number of landmarks on the plane.
    landmarks: int
    #: Angle between the normal of the plane and the expected direction, in the first camera.
    tilt_deg: float


def find_ground(map_: InitialMap, *, nadir: bool = False) -> Ground:
    """Find the ground plane, or raise why no plane is certain.

    * ``nadir``: Whether the camera looks down, so that the ground lies ahead of it and not below.
    """
    seen = inverse_depths(map_)
    where = "ahead of" if nadir else "below"
    best = _best_plane(seen, nadir) if len(seen.values) > 3 else None
    if best is None:
        raise NoScaleError(f"no plane lies {where} the camera with nothing beneath it")
    count = int(best.inliers.sum())
    if best.log_false_alarms > math.log(_FALSE_ALARMS):
        found = f"the best one has {count} of {len(best.inliers)} landmarks"
        raise NoScaleError(f"no plane {where} the camera is certain: {found}")
    if not _faces(best.k, nadir):
        raise NoScaleError(f"the plane of {count} landmarks does not lie {where} the camera: it is tilted too far")
    return _ground(map_, seen, best, nadir)


@dataclass(frozen=True, eq=False)
class _Plane:
    """A plane ``k . X = 1``, its inliers, the number of such planes expected without a ground, and the slopes."""

    k: Floats
    inliers: Bools
    log_false_alarms: float
    waves_rad: float


def _expected(nadir: bool) -> Floats:
    return np.array([0.0, 0.0, 1.0] if nadir else [0.0, 1.0, 0.0])


def _faces(planes: Floats, nadir: bool) -> Bools:
    """Whether planes (..., 3) lie in the expected direction."""
    length = np.linalg.norm(planes, axis=-1)
    facing = (length > 0) & (planes @ _expected(nadir) >= _LEAST_COSINE * length)
    return np.asarray(facing if nadir else facing & (np.abs(planes[..., 0]) <= _MOST_ROLL * length))


def _tolerances(k: Floats, seen: InverseDepths, waves_rad: float) -> tuple[Floats, Floats]:
    """The inverse depths that a plane predicts, and the standard deviation of a difference from them."""
    predicted = seen.rays @ k
    waves = waves_rad * float(np.linalg.norm(k)) * np.linalg.norm(seen.rays, axis=1)
    return predicted, np.sqrt(seen.sigmas**2 + (_ROUGHNESS * predicted) ** 2 + waves**2)


def _evaluated(k: Floats, seen: InverseDepths, nadir: bool, waves_rad: float = _FIRST_WAVES_RAD) -> _Plane | None:
    """A plane with its inliers; None where landmarks lie beneath it."""
    predicted, tolerance = _tolerances(k, seen, waves_rad)
    off = (predicted - seen.values) / tolerance
    hit = predicted > 0
    inliers = hit & (np.abs(off) < _SIGMAS)
    count, beneath = int(inliers.sum()), int(np.sum(hit & (off > _SIGMAS)))
    if count <= 3 or beneath > _BENEATH * count:
        return None
    reach = _SIGMAS * tolerance[hit]
    if nadir:
        by_chance = float(np.sum(np.minimum(1.0, reach / predicted[hit])))
    else:
        depths = np.sort(seen.values[hit])
        within = np.searchsorted(depths, predicted[hit] + reach) - np.searchsorted(depths, predicted[hit] - reach)
        by_chance = float(np.sum(within)) / len(depths)
    rarity = count * math.log(count / by_chance) - count + by_chance if count > by_chance else 0.0
    return _Plane(k, inliers, math.log(math.comb(len(seen.values), 3)) - rarity, waves_rad)


def _best_plane(seen: InverseDepths, nadir: bool) -> _Plane | None:
    """The most significant plane. Refined, it may lie in another direction than expected."""
    rng = np.random.default_rng(0)
    triples = rng.integers(len(seen.values), size=(_SAMPLES, 3))
    A = seen.rays[triples]
    solvable = np.abs(np.linalg.det(A)) > 1e-9
    planes = np.linalg.solve(A[solvable], seen.values[triples[solvable]][:, :, None])[:, :, 0]
    evaluated = (_evaluated(k, seen, nadir) for k in planes[_faces(planes, nadir)][:_CANDIDATES])
    best = min((one for one in evaluated if one is not None), key=lambda plane: plane.log_false_alarms, default=None)
    if best is None:
        return None
    refined = (_evaluated(_fitted(best.k, seen, waves, best.inliers), seen, nadir, waves) for waves in _WAVES_RAD)
    better = [plane for plane in refined if plane is not None]
    return min(better, key=lambda plane: plane.log_false_alarms, default=best)


def _fitted(start: Floats, seen: InverseDepths, waves_rad: float, chosen: Bools) -> Floats:
    """The robust least-squares plane of some inliers of a plane; the start where they determine none."""
    k = start
    for _ in range(_REFINEMENTS):
        predicted, tolerance = _tolerances(k, seen, waves_rad)
        off = ((predicted - seen.values) / tolerance)[chosen]
        weight = 1 / (tolerance[chosen] ** 2 * (1 + (off / CAUCHY) ** 2))
        weighted = seen.rays[chosen] * weight[:, None]
        normal = weighted.T @ seen.rays[chosen]
        if np.linalg.matrix_rank(normal) < 3:
            return start
        k = np.asarray(np.linalg.solve(normal, weighted.T @ seen.values[chosen]), float)
    return k


def _jackknife(plane: _Plane, seen: InverseDepths) -> float:
    """Relative variance of the distance to a plane, from the planes without each of its parts."""

    def thirds(values: Floats) -> Ints:
        borders = np.quantile(values[plane.inliers], np.arange(1, _PARTS) / _PARTS)
        return np.asarray(np.searchsorted(borders, values))

    parts = _PARTS * thirds(seen.rays[:, 0]) + thirds(seen.rays[:, 1])
    others = (plane.inliers & (parts != part) for part in np.unique(parts[plane.inliers]))
    fits = (_fitted(plane.k, seen, plane.waves_rad, other) for other in others)
    logs = np.array([math.log(float(np.linalg.norm(k))) for k in fits])
    return (len(logs) - 1) / len(logs) * float(np.sum((logs - logs.mean()) ** 2))


def _ground(map_: InitialMap, seen: InverseDepths, plane: _Plane, nadir: bool) -> Ground:
    """The height of the cameras above a plane, with its variance and its derivatives by the poses."""
    first = map_.keyframes[0].world_from_cam
    cameras = first.inverse().apply(np.array([keyframe.world_from_cam.t for keyframe in map_.keyframes]))
    k, inliers = plane.k, plane.inliers
    length = float(np.linalg.norm(k))
    heights = (1 - cameras @ k) / length
    if heights.min() <= 0:
        raise NoScaleError(f"the camera does not stay on one side of the plane {'ahead of' if nadir else 'below'} it")
    height = float(heights.mean())
    _, tolerance = _tolerances(k, seen, plane.waves_rad)
    weighted = seen.rays[inliers] / tolerance[inliers, None] ** 2
    covariance = np.linalg.inv(weighted.T @ seen.rays[inliers])
    by_plane = -(cameras.mean(axis=0) / length + height * k / length**2)
    by_poses = by_plane @ covariance @ weighted.T @ seen.by_poses[inliers]
    for i, keyframe in enumerate(map_.keyframes):
        # A camera that moves away from the plane is higher, for a given plane.
        in_first = first.R.T @ keyframe.world_from_cam.R
        by_poses[6 * i + 3 : 6 * i + 6] -= (k / length) @ in_first / len(cameras)
    # The jackknife contains the noise of the landmarks.
    variance = max(float(by_plane @ covariance @ by_plane) / height**2, _jackknife(plane, seen)) + _LEAST_SIGMA**2
    tilt = math.degrees(math.acos(min(1.0, float(k @ _expected(nadir)) / length)))
    return Ground(height, variance, by_poses / height, int(inliers.sum()), tilt)
