"""Reliability of the stated risk: one decision a world, expected against observed false maps.

Each world goes through an :class:`~slam_init.initializer.Initializer` as tracks, until it decides or the world ends. A
map is false if a rotation is off by 5 degrees or more, if the direction of a baseline is off by 15 degrees or more, or
if the camera does not translate. Baselines below three tenths of the longest one of the map are left out: their
directions mean little. The sum of the stated risks is the number of false maps that is expected. ::

    python -m tests.benchmarks.reliability --seeds 200000 200050
    python -m tests.benchmarks.reliability --seeds 10000 10500 --worlds PATH/gen.py --log other.jsonl
    python -m tests.benchmarks.reliability --from-log other.jsonl

Worlds by another hand come from a Python file with two functions. ``draw_factors(seed)`` returns a dict of factors.
``make(factors)`` returns None, or a dict: ``W, H`` the size of the image, ``fs`` the stated focal length and ``cs`` the
stated principal point, ``frames`` a list of (index, time, track ids, pixels), ``poses`` a list of (R, t) of
``world_from_cam``, and ``notrans`` whether the camera does not translate. For the coverage of points, ``X`` holds the
point of each track id and ``kind`` 0 for those at rest.
"""

import importlib.util
import math
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.compare.statistics import wilson
from slam_init.datasets.synth import PointSource, open_points
from slam_init.initializer import Initializer
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.initial_map import UNMODELLED_RISK, InitialMap
from slam_init.types.pose import Pose
from slam_init.window.motion import difference_deg
from tests.benchmarks.options import append_row, program, read_rows, show
from tests.benchmarks.tables import markdown_table

#: What counts as wrong, in degrees, and the shortest baseline that is evaluated, over the longest one.
ROTATION_DEG, DIRECTION_DEG, _SHORTEST = 5.0, 15.0, 0.3
#: Scenes and baselines of the built-in generator; the last two do not translate.
_SCENES = ("room", "corridor", "wall", "desk", "nadir", "nadir-turn", "tilted-30", "rotation", "static")
_BASELINES, _WITHOUT_TRANSLATION = (0.03, 0.05, 0.1), ("rotation", "static")
#: A factor with more values has no table of its own.
_MOST_VALUES = 16
#: Bounds of the bins of the stated risk.
_BINS = (0.0, 6e-4, 1e-3, 2e-3, 5e-3)


@dataclass(frozen=True)
class World:
    """A world as its tracks and its truth."""

    camera: Camera
    views: list[Observations]
    #: By index of the frame; some indices may be missing.
    world_from_cam: Mapping[int, Pose]
    no_translation: bool
    #: The factors that it was made from.
    factors: Mapping[str, Any]
    #: (T, 3) By track id; NaN where there is none.
    points: Floats


@dataclass(frozen=True)
class Decision:
    """What an initializer decided on a world. Figures are NaN without a map."""

    seed: int
    factors: dict[str, Any]
    #: correct, false, none.
    outcome: str
    #: The frames after the first one up to the decision.
    wait: int
    no_translation: bool
    reason: str = ""
    #: Its part by the model.
    risk: float = math.nan
    rotation_deg: float = math.nan
    direction_deg: float = math.nan
    #: The error of the direction of the pair over its stated standard deviation.
    deviations: float = math.nan
    #: The largest error of a direction in the map, which is that of a shorter baseline mostly, over the same deviation.
    largest_deviations: float = math.nan


def initialized(world: World) -> tuple[Initializer, int]:
    """An initializer that has the tracks of a world until it decided, and the frames after the first one until then."""
    initializer, wait = Initializer(world.camera), -1
    for view in world.views:
        wait += 1
        if initializer.process_tracks(view):
            break
    return initializer, wait


def decide(world: World, seed: int) -> Decision:
    """Give the tracks of a world to an initializer, and evaluate its map."""
    initializer, wait = initialized(world)
    status, factors = initializer.status, dict(world.factors)
    if initializer.map is None:
        return Decision(seed, factors, "none", wait, world.no_translation, str(status.reason))
    rotation, direction = errors_deg(initializer.map, world.world_from_cam)
    wrong = is_wrong((rotation, direction), world)
    attempt = status.attempt
    window = None if attempt is None else attempt.window
    sigma = math.nan if window is None else window.direction_sigma_deg
    of_pair = math.nan if attempt is None else _of_pair_deg(initializer.map, world, attempt.frames)
    return Decision(
        seed, factors, "false" if wrong else "correct", wait, world.no_translation, "",
        initializer.map.model_risk if initializer.map.model_risk is not None else math.nan, rotation, direction,
        of_pair / sigma, direction / sigma,
    )  # fmt: skip


def errors_deg(map_: InitialMap, truth: Mapping[int, Pose]) -> tuple[float, float]:
    """Largest errors of a rotation and of the direction of a baseline; short baselines are left out."""
    first, *others = map_.keyframes
    errors = []
    for one in others:
        found = one.world_from_cam.inverse() @ first.world_from_cam
        true = truth[one.frame].inverse() @ truth[first.frame]
        rotation, direction = difference_deg(found, true)
        errors.append((float(np.linalg.norm(true.t)), rotation, direction if true.t.any() else 180.0))
    longest = max(length for length, _, _ in errors)
    directions = [direction for length, _, direction in errors if length >= _SHORTEST * longest]
    return max(rotation for _, rotation, _ in errors), max(directions)


def is_wrong(errors: tuple[float, float], world: World) -> bool:
    """Whether a map or a motion with these errors is wrong."""
    return world.no_translation or errors[0] >= ROTATION_DEG or errors[1] >= DIRECTION_DEG


def _of_pair_deg(map_: InitialMap, world: World, frames: Sequence[int]) -> float:
    """The error of the direction of the pair, whose deviation is stated."""
    first, second = (next(one for one in map_.keyframes if one.frame == frame) for frame in frames[:2])
    found, truth = second.world_from_cam.inverse() @ first.world_from_cam, world.world_from_cam
    return difference_deg(found, truth[second.frame].inverse() @ truth[first.frame])[1]


def built_in(seed: int) -> Iterator[World]:
    """The worlds of the built-in generator of a seed, which also chooses the noise and the share of the outliers."""
    noise_px, outliers = (0.3, 0.7, 1.0)[seed % 3], (0.05, 0.15, 0.3)[seed // 3 % 3]
    for scene in _SCENES:
        for baseline in _BASELINES[:1] if scene in _WITHOUT_TRANSLATION else _BASELINES:
            source = open_points(f"points:{scene}?baseline={baseline}&noise_px={noise_px}&outliers={outliers}", seed)
            factors = {"scene": scene, "baseline": baseline, "noise": noise_px, "outliers": outliers}
            yield world_of(source, factors, no_translation=scene in _WITHOUT_TRANSLATION)


def world_of(source: PointSource, factors: Mapping[str, Any], *, no_translation: bool = False) -> World:
    """A simulated source as a world; its outliers and moving points have no point."""
    sequence, poses = source.sequence, dict(enumerate(source.groundtruth.world_from_cam))
    points = np.where((sequence.is_outlier | sequence.is_moving)[:, None], np.nan, sequence.points)
    return World(source.camera, list(source.observations()), poses, no_translation, factors, points)


def by_another_hand(path: Path) -> Callable[[int], Iterator[World]]:
    """The worlds of a Python file; see the module docstring."""
    spec = importlib.util.spec_from_file_location("worlds_by_another_hand", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"reliability: {path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def worlds(seed: int) -> Iterator[World]:
        factors = module.draw_factors(seed)
        made = module.make(factors)
        if made is None:
            return
        cx, cy = (float(value) for value in made["cs"])
        camera = Camera("pinhole", made["W"], made["H"], made["fs"], made["fs"], cx, cy)
        views = [
            Observations(index, time_s, str(index), ids.astype(np.int64), pixels, camera.bearings(pixels))
            for index, time_s, ids, pixels in made["frames"]
        ]
        poses = {view.frame: Pose(R, t) for view, (R, t) in zip(views, made["poses"], strict=True)}
        plain = {key: value.item() if hasattr(value, "item") else value for key, value in factors.items()}
        points = np.where((made["kind"] == 0)[:, None], made["X"], np.nan) if "X" in made else np.zeros((0, 3))
        yield World(camera, views, poses, bool(made["notrans"]), plain, points)

    return worlds


def report(decisions: Sequence[Decision]) -> str:
    """The tables of some decisions."""
    tables = [_summary(decisions), _by_risk(decisions)]
    for name in decisions[0].factors if decisions else ():
        groups: dict[str, list[Decision]] = {}
        for one in decisions:
            groups.setdefault(str(one.factors.get(name)), []).append(one)
        if len(groups) <= _MOST_VALUES:
            rows = [[value, *_counts(groups[value])] for value in sorted(groups)]
            tables.append(markdown_table([name, *_HEADER], rows))
    return f"Commit {commit()}.\n\n" + "\n\n".join(tables)


_HEADER = [
    "worlds",
    "correct",
    "false",
    "none",
    "false expected by the model",
    "and by what it lacks",
    "wait (frames)",
    "direction of the pair beyond 2 sigma %",
    "beyond 3 sigma %",
    "of any keyframe beyond 3 sigma %",
]


def _counts(group: Sequence[Decision]) -> list[str]:
    maps = [one for one in group if one.outcome != "none"]
    counts = [str(sum(one.outcome == outcome for one in group)) for outcome in ("correct", "false", "none")]
    expected = sum(one.risk for one in maps)
    with_causes = expected + len(maps) * UNMODELLED_RISK
    wait = f"{np.mean([one.wait for one in maps]):.2f}" if maps else "-"
    evaluated = [one for one in maps if not one.no_translation]
    of_pair, of_any = (
        np.array([getattr(one, name) for one in evaluated]) for name in ("deviations", "largest_deviations")
    )
    beyond = [(of_pair, 2), (of_pair, 3), (of_any, 3)]
    shares = [f"{100 * float(np.mean(errors > level)):.1f}" if evaluated else "-" for errors, level in beyond]
    return [str(len(group)), *counts, f"{expected:.2f}", f"{with_causes:.2f}", wait, *shares]


def _summary(decisions: Sequence[Decision]) -> str:
    moving = [one for one in decisions if not one.no_translation]
    still = [one for one in decisions if one.no_translation]
    groups = {"all": decisions, "the camera translates": moving, "it does not": still}
    rows = [[name, *_counts(group)] for name, group in groups.items()]
    return markdown_table(["", *_HEADER], rows)


def _by_risk(decisions: Sequence[Decision]) -> str:
    maps = [one for one in decisions if one.outcome != "none"]
    rows = []
    for low, high in pairwise(_BINS):
        group = [one for one in maps if low < one.risk <= high]
        if not group:
            continue
        false = sum(one.outcome == "false" for one in group)
        interval = wilson(false, len(group))
        expected = sum(one.risk for one in group)
        rows.append(
            [f"{low:g} to {high:g}", str(len(group)), f"{expected:.2f}", str(false),
             f"{100 * interval.low:.2f} to {100 * interval.high:.2f}"]
        )  # fmt: skip
    return markdown_table(["stated risk", "maps", "false expected", "false", "false %, 95 % interval"], rows)


def commit() -> str:
    """The commit of the measured version, with a mark where files differ from it."""
    message = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parent,
    )
    return message.stdout.strip() or "unknown"


def main() -> None:
    """Print the tables."""
    parser = program("reliability", __doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(200_000, 200_020), metavar=("FIRST", "END"))
    parser.add_argument("--worlds", type=Path, metavar="FILE", help="worlds by another hand (default: built in)")
    parser.add_argument("--log", type=Path, metavar="FILE", help="append one JSON line a world")
    parser.add_argument("--from-log", type=Path, nargs="+", default=[], metavar="FILE", help="of logs; run nothing")
    options = parser.parse_args()
    decisions = [one for path in options.from_log for one in read_rows(path, Decision)]
    worlds = built_in if options.worlds is None else by_another_hand(options.worlds)
    for seed in () if options.from_log else range(*options.seeds):
        for world in worlds(seed):
            decisions.append(decide(world, seed))
            append_row(options.log, decisions[-1])
    show(report(decisions) + "\n", options.out)


if __name__ == "__main__":
    main()
