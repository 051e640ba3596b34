"""How often the stated deviations of a map cover its true errors: ``python -m tests.benchmarks.coverage``.

Each world has one map. The share of its keyframes and landmarks whose true value lies in the 95 % ellipsoid of the
stated covariance is counted, and the mean over the maps is shown with its 95 % interval, as the errors within a map are
not independent. The true poses and points are aligned with the map by the first pose, and by the distance to the
keyframe farthest from it, as the gauge of the graph is.

``python -m tests.benchmarks.coverage 60``
    60 simulated worlds of each stratum: exact lens; focal length, principal point or k1 off by the standard deviations
    of :mod:`slam_init.bundle.covariances`; an independent or a drifting field of correlated errors.
``python -m tests.benchmarks.coverage 300 --worlds PATH/gen.py --seed 10000``
    300 worlds of another generator, as of :mod:`tests.benchmarks.reliability`.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from slam_init.datasets.synth import open_points
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose
from tests.benchmarks.options import program, show
from tests.benchmarks.reliability import World, by_another_hand, commit, errors_deg, initialized, is_wrong, world_of
from tests.benchmarks.tables import markdown_table

#: Quantiles of chi-square at 95 % by degrees of freedom.
_CHI95 = {3: 7.815, 5: 11.070, 6: 12.592}
_SCENES = (
    *("room", "wall", "nadir", "nadir-turn", "corridor", "desk"),
    *("rotate-then-move", "tilted-15", "tilted-30", "tilted-45"),
)
_STRATA = ("exact", "focal", "principal", "k1", "field", "drift")


@dataclass(frozen=True)
class Coverage:
    """Shares of one map within its stated 95 %."""

    stratum: str
    poses: float
    points: float
    depths: float


def coverage_of(world: World, map_: InitialMap) -> Coverage | None:
    """Evaluate a map; None if it is false, which no deviation says."""
    if is_wrong(errors_deg(map_, world.world_from_cam), world):
        return None
    first = map_.keyframes[0]
    estimated = [first.world_from_cam.inverse() @ keyframe.world_from_cam for keyframe in map_.keyframes]
    start = world.world_from_cam[first.frame].inverse()
    true = [start @ world.world_from_cam[keyframe.frame] for keyframe in map_.keyframes]
    lengths = np.array([np.linalg.norm(pose.t) for pose in estimated])
    far = int(np.argmax(lengths))
    scale = lengths[far] / max(float(np.linalg.norm(true[far].t)), 1e-12)
    inside = []
    for k in range(1, len(true)):
        moved = estimated[k].inverse() @ Pose(true[k].R, scale * true[k].t)
        error = gtsam.Pose3.Logmap(gtsam.Pose3(gtsam.Rot3(moved.R), moved.t))
        inside.append(error @ np.linalg.solve(map_.pose_covariances[k], error) < _CHI95[5 if k == far else 6])
    points = first.world_from_cam.apply(scale * start.apply(world.points[map_.track_ids]))
    good = np.flatnonzero(np.isfinite(points).all(axis=1))
    if len(good) == 0:
        return None
    errors, covariances = (points - map_.points)[good], map_.point_covariances[good]
    squared = np.einsum("li,li->l", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])
    newest = map_.keyframes[-1].world_from_cam
    true_newest = first.world_from_cam @ Pose(true[-1].R, scale * true[-1].t)
    depths = np.linalg.norm(newest.inverse().apply(map_.points[good]), axis=1)
    off = np.linalg.norm(true_newest.inverse().apply(points[good]), axis=1) / depths - 1
    return Coverage(
        str(world.factors["stratum"]),
        float(np.mean(inside)),
        float(np.mean(squared < _CHI95[3])),
        float(np.mean(np.abs(off) < 1.96 * map_.depth_sigmas[good])),
    )


def simulated_worlds(count: int, seed: int) -> Iterator[World]:
    """Draw ``count`` worlds of each stratum."""
    for number in range(count):
        for stratum in _STRATA:
            yield simulated_world(stratum, seed + number)


def simulated_world(stratum: str, seed: int) -> World:
    """A world of the built-in generator."""
    rng = np.random.default_rng((seed, *stratum.encode()))
    off, size = float(rng.normal()), float(rng.uniform(0.1, 0.5))
    error = {
        "focal": f"&focal_error={0.02 * off}",
        "principal": f"&principal_error={0.025 * abs(off)}",
        "k1": f"&k1={0.05 * off}",
        "field": f"&correlated_px={size}",
        "drift": f"&drift_px={size}",
    }.get(stratum, "")
    scene, baseline = _SCENES[seed % len(_SCENES)], rng.choice([0.05, 0.1, 0.2, 0.4])
    noise, points = rng.choice([0.2, 0.4, 0.7]), rng.choice([150, 300, 600])
    text = f"points:{scene}?views=20&noise_px={noise}&baseline={baseline}&points={points}{error}"
    return world_of(open_points(text, seed), {"stratum": stratum})


def other_worlds(path: Path, count: int, seed: int) -> Iterator[World]:
    """Worlds of another generator, without those in which the camera does not translate."""
    worlds = by_another_hand(path)
    for world in (world for number in range(seed, seed + count) for world in worlds(number)):
        if not world.no_translation:
            yield replace(world, factors={"stratum": _stratum_of(world.factors)})


def _stratum_of(factors: Any) -> str:
    """Correlated errors come first: they are there with any lens."""
    if factors["noise"] in ("jitter", "regionbias"):
        return str(factors["noise"])
    size = 0.05 * factors["calsize"] / {"focal": 0.02, "pp": 0.025, "k1": 0.05}.get(factors["cal"], 1.0)
    beyond = ", over 2 sigma" if size > 2 else ""
    return f"{factors['cal']}{beyond}"


def table(rows: Sequence[Coverage]) -> str:
    """The table in markdown, with the commit that it was measured on."""
    lines = []
    for stratum in ["all", *dict.fromkeys(row.stratum for row in rows)]:
        part = [row for row in rows if stratum in ("all", row.stratum)]
        cells = [_share([getattr(row, figure) for row in part]) for figure in ("poses", "points", "depths")]
        lines.append([stratum, str(len(part)), *cells])
    return f"{markdown_table(['within 95 %', 'maps', 'poses', 'points', 'depths'], lines)}\n\ncommit {commit()}"


def _share(values: Sequence[float]) -> str:
    mean, spread = float(np.mean(values)), 1.96 * float(np.std(values)) / math.sqrt(len(values))
    return f"{100 * mean:.0f} [{100 * max(mean - spread, 0):.0f}, {100 * min(mean + spread, 1):.0f}]"


def main() -> None:
    """Measure, and print the table."""
    parser = program("coverage", __doc__)
    parser.add_argument("count", type=int, nargs="?", default=20, help="worlds, of each stratum (default: 20)")
    parser.add_argument("--seed", type=int, default=0, help="of the first world")
    parser.add_argument("--worlds", type=Path, metavar="FILE", help="another generator")
    options = parser.parse_args()
    worlds = simulated_worlds(options.count, options.seed)
    if options.worlds is not None:
        worlds = other_worlds(options.worlds, options.count, options.seed)
    maps = ((world, initialized(world)[0].map) for world in worlds)
    found = [coverage_of(world, map_) for world, map_ in maps if map_ is not None]
    show(table([row for row in found if row is not None]) + "\n", options.out)


if __name__ == "__main__":
    main()
