"""How often a wrong focal length is named, and how often a right one is called wrong.

Each world is seen once through a calibration that is off by up to a hundredth, and another world of the same seed
through one that is wrong by 7 to 100 %. Both are tracks without images. The same frames with a wrong one that is not
named are seen again without any calibration: the tracks determine the focal length where that run knows it well enough
to tell the true one from the stated one. ::

    python -m tests.benchmarks.wrong_calibration --seeds 50000 50100 --log PATH.jsonl
    python -m tests.benchmarks.wrong_calibration --from-log PATH.jsonl
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from slam_init.calibration.files import prior_camera
from slam_init.compare.statistics import wilson
from slam_init.datasets.synth import PointSource, open_points
from slam_init.initializer import Initializer
from slam_init.types.camera import Camera
from slam_init.types.result import Result
from tests.benchmarks.options import progress, show
from tests.benchmarks.reliability import commit
from tests.benchmarks.tables import markdown_table

#: Scenes by their kind: structure, planes, forward motion, a camera that only rotates.
_SCENES = {
    "room": "structure", "handheld": "structure", "rotate-then-move": "structure", "wall": "plane",
    "handheld-wall": "plane", "desk": "plane", "nadir": "plane", "nadir-turn": "plane", "tilted-30": "plane",
    "corridor": "forward", "rotation": "rotation", "pan": "rotation",
}  # fmt: skip
#: A total path that is shorter than this share of the median depth is little parallax.
_LITTLE = 0.1
#: Stated focal lengths over the true one: a right one, and the two ranges of a wrong one.
_RIGHT, _SHORT, _LONG = 0.01, (0.5, 0.93), (1.08, 2.0)
#: The tracks tell a wrong focal length that is off by so many deviations of a run without a calibration.
_SIGNIFICANT_SIGMAS = 3.0


@dataclass(frozen=True)
class Case:
    """A world, how it was stated, and what a run said of its focal length."""

    seed: int
    scene: str
    kind: str
    #: Stated focal length over the true one.
    stated: float
    is_wrong: bool
    initialized: bool
    frames: int
    named: bool
    #: Estimated focal length over the true one, and its relative standard deviation; NaN where none is named.
    estimated: float = math.nan
    sigma: float = math.nan
    #: Whether a run without a calibration shows a wrong focal length; as for all that are named.
    clear: bool = False
    #: All free fits: over the true focal length, their deviation, and the place of their attempt.
    fits: list[tuple[float, float, int]] = field(default_factory=list)


def simulated(seed: int, *, is_wrong: bool) -> tuple[str, PointSource, float]:
    """Draw a world; returns its scene, its source and the stated focal length over the true one."""
    rng = np.random.default_rng([seed, is_wrong])
    scene = str(rng.choice(list(_SCENES)))
    short, long = (np.log(bounds) for bounds in (_SHORT, _LONG))
    at = rng.uniform(0, np.ptp(short) + np.ptp(long))
    wrong = math.exp(short[0] + at) if at < np.ptp(short) else math.exp(long[0] + at - np.ptp(short))
    stated = wrong if is_wrong else 1 + rng.uniform(-_RIGHT, _RIGHT)
    options = {
        "views": rng.integers(6, 11), "points": 150, "noise_px": rng.choice([0.3, 0.5, 0.8]),
        "outliers": rng.choice([0.02, 0.1, 0.25]), "correlated_px": rng.choice([0.0, 0.15, 0.3]),
        "baseline": math.exp(rng.uniform(math.log(0.05), math.log(0.6))),
        "principal_error": rng.choice([0.0, 0.005, 0.01]), "k1": rng.choice([0.0, 0.0, -0.02, 0.02]),
        "turning_deg_s": rng.choice([20.0, 40.0, 60.0]), "speed": rng.choice([0.0, 0.1, 0.3, 0.6]),
        "focal_error": stated - 1,
    }  # fmt: skip
    query = "&".join(f"{name}={value}" for name, value in options.items())
    return scene, open_points(f"points:{scene}?{query}", seed), stated


def decide(seed: int, *, is_wrong: bool) -> Case:
    """Draw a world and run it; a wrong focal length that is not named is run again without a calibration."""
    scene, source, stated = simulated(seed, is_wrong=is_wrong)
    options, kind = source.sequence.options, _SCENES[scene]
    if kind in ("structure", "plane") and options.baseline < _LITTLE and not scene.startswith("handheld"):
        kind = "little parallax"
    if scene.startswith("handheld") and options.speed == 0:
        kind = "rotation"
    result = _run(source, source.camera)
    wrong = result.wrong_focal
    fits = [(k, attempt.free_focal) for k, attempt in enumerate(result.attempts) if attempt.free_focal is not None]
    case = Case(
        seed, scene, kind, stated, is_wrong, result.map is not None, result.frames_read, wrong is not None,
        fits=[(stated * fit.factor, fit.sigma_px / fit.estimated_px, k) for k, fit in fits],
    )  # fmt: skip
    if wrong is not None:
        return replace(case, estimated=stated * wrong.factor, sigma=wrong.sigma_px / wrong.estimated_px, clear=True)
    if not is_wrong:
        return case
    free = _run(source, prior_camera((source.camera.width, source.camera.height)), result.frames_read)
    sigmas = [attempt.window.focal_sigma for attempt in free.attempts if attempt.window is not None]
    return replace(case, clear=_SIGNIFICANT_SIGMAS * min(sigmas, default=math.inf) < abs(math.log(stated)))


def _run(source: PointSource, camera: Camera, frames: int | None = None) -> Result:
    initializer = Initializer(camera)
    for view in islice(source.observations(), frames):
        if initializer.process_tracks(replace(view, bearings=camera.bearings(view.pixels))):
            break
    return initializer.finish()


def _is_of_kind(kind: str, case: Case) -> bool:
    return case.kind == kind


def _is_within(low: float, high: float, case: Case) -> bool:
    return not case.is_wrong or low <= case.stated <= high


def report(cases: Sequence[Case]) -> str:
    """The tables of some cases."""
    wrong, right = [one for one in cases if one.is_wrong], [one for one in cases if not one.is_wrong]
    groups: list[tuple[str, Callable[[Case], bool]]] = [
        ("all", lambda one: True),
        *((kind, partial(_is_of_kind, kind)) for kind in sorted({one.kind for one in cases})),
        ("with a map", lambda one: one.initialized),
        ("without a map", lambda one: not one.initialized),
        *(
            (f"stated {low:g} to {high:g}", partial(_is_within, low, high))
            for low, high in ((0.5, 0.7), (0.7, 0.93), (1.08, 1.4), (1.4, 2.0))
        ),
    ]
    rows = []
    for name, belongs in groups:
        clear = [one for one in wrong if belongs(one) and one.clear]
        called = [] if name.startswith("stated") else [one.named for one in right if belongs(one)]
        rows.append([name, _share([one.named for one in clear]), _share([one.named for one in wrong if belongs(one)]),
                     _share(called)])  # fmt: skip
    header = ["worlds", "wrong, clear: named", "wrong, all: named", "right: called wrong"]
    named = [one for one in wrong if one.named]
    near = [_share([abs(math.log(one.estimated)) <= n * one.sigma for one in named]) for n in (1, 2)]
    within = f"Estimates that are named: within one deviation {near[0]}, within two {near[1]}."
    return f"Commit {commit()}.\n\n{markdown_table(header, rows)}\n\n{within}\n"


def _share(flags: Sequence[bool]) -> str:
    """A share in per cent with its counts and its interval of 95 %."""
    if not flags:
        return "-"
    interval = wilson(sum(flags), len(flags))
    low, high = 100 * interval.low, 100 * interval.high
    return f"{100 * sum(flags) / len(flags):.1f} % ({sum(flags)} of {len(flags)}; {low:.1f} to {high:.1f})"


def read_log(path: Path) -> list[Case]:
    """The cases of a log."""
    return [Case(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.wrong_calibration", allow_abbrev=False)
    parser.description = "How often a wrong focal length is named, and a right one called wrong."
    parser.add_argument("--seeds", type=int, nargs=2, default=(50_000, 50_020), metavar=("FIRST", "END"))
    parser.add_argument("--log", type=Path, metavar="FILE", help="append one JSON line a world")
    parser.add_argument("--from-log", type=Path, nargs="+", metavar="FILE", help="tables of logs; run nothing")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the tables to a file as well")
    options = parser.parse_args(argv)
    cases = [one for path in options.from_log or () for one in read_log(path)]
    for seed in progress([] if options.from_log else range(*options.seeds), "seed"):
        for is_wrong in (False, True):
            cases.append(decide(seed, is_wrong=is_wrong))
            if options.log is not None:
                with options.log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(cases[-1])) + "\n")
    show(report(cases), options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
