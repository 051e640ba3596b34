"""Maps of rival methods under ``slam_init.audit``: what is found of the false ones, the false alarms, and the risk.

Each method gets the tracks of a world, or of a start of a film, until it has a map. The audit gets the poses of the map
and the same tracks: up to the frame of the map, and a second time with those of the frames after it. A map is false by
the rule of ``tests.benchmarks.reliability``. It is found where the audit does not call it sound. A false alarm is a
right map that is called wrong. ::

    python -m tests.benchmarks.audit --seeds 430000 430003 --log audit.jsonl
    python -m tests.benchmarks.audit --film --log film.jsonl
    python -m tests.benchmarks.audit --from-log audit.jsonl film.jsonl --out tests/benchmarks/measured/audit.md

Films are read below ``SLAM_INIT_DATA``. The numbers of the audit were chosen on seeds 410000 and 410001 and on every
third start of the films, which is left out.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from slam_init import audit, open_source
from slam_init.compare.statistics import wilson
from slam_init.config import Config
from slam_init.frontend.tracks import Tracker
from slam_init.methods.registry import make_initializer
from slam_init.output.tables import markdown_table
from tests.benchmarks.options import show
from tests.benchmarks.reliability import DIRECTION_DEG, ROTATION_DEG, World, built_in, commit, errors_deg

#: The rivals whose maps are judged.
METHODS = ("colmap", "poselib", "essential-5pt", "essential-8pt", "orb-slam3", "homography", "opensfm")
#: Films below the data folder, with the step between their starts; the last one only turns. 7-Scenes has no part: its
#: true positions come from depth maps of another camera, and do not tell the directions of short baselines.
FILMS = {
    "tsukuba/new_tsukuba_150": 20,
    "tartanair/hospital_clip": 5,
    "planar/checkerboard_desk": 20,
    "kitti/06_start": 10,
    "strecha/castle-P19": 3,
    "strecha/fountain-P11": 2,
    "strecha/entry-P10": 2,
    "middlebury/templeRing_19": 3,
    "panorama/parrington": 3,
}
_WITHOUT_TRANSLATION = "panorama/parrington"
#: Frames of a start of a film.
_LENGTH = 40
#: Every third start chose numbers of the audit.
_CHOSE = 3
#: Bounds of the bins of the stated risk.
_BINS = (0.0, 0.005, 0.05, 0.2, 0.5, 0.8, 1.0)


@dataclass(frozen=True)
class Judged:
    """A map of a rival method, and what the audit says of it."""

    source: str
    factors: dict[str, Any]
    seed: int
    method: str
    false: bool
    no_translation: bool
    rotation_deg: float
    direction_deg: float
    #: Verdict and stated risk with the tracks up to the map, then with those of further frames.
    verdict: str
    risk: float
    verdict_later: str
    risk_later: float


def judge(world: World, source: str, seed: int, method: str) -> Judged | None:
    """Let a method make its map of a world, and audit the map; None without a map."""
    initializer, count = make_initializer(method, world.camera, Config()), 0
    for view in world.views:
        count += 1
        if initializer.process_tracks(view):
            break
    map_ = initializer.map
    if map_ is None:
        return None
    rotation, direction = errors_deg(map_, world.world_from_cam)
    false = world.no_translation or rotation >= ROTATION_DEG or direction >= DIRECTION_DEG
    poses = {one.frame: one.world_from_cam for one in map_.keyframes}
    found = [audit(poses, world.views[:last], world.camera) for last in (count, None)]
    told = [(str(one.verdict), one.risk) for one in found]
    return Judged(
        source, dict(world.factors), seed, method, false, world.no_translation, rotation, direction, *told[0], *told[1]
    )


def worlds_of(seeds: Iterable[int]) -> Iterator[tuple[str, int, World]]:
    """The simulated worlds of some seeds."""
    for seed in seeds:
        for world in built_in(seed):
            yield "simulated", seed, world


def films() -> Iterator[tuple[str, int, World]]:
    """The starts of the films that are there, tracked by the front end of this project."""
    root = Path(os.environ.get("SLAM_INIT_DATA", "../shared/data"))
    for name, step in FILMS.items():
        if not (root / name).is_dir():
            continue
        source = open_source(root / name)
        truth, camera = source.groundtruth, source.camera
        if truth is None or camera is None:
            continue
        for number, start in enumerate(range(0, len(source) - 5, step)):
            if number % _CHOSE == 0:
                continue
            tracker = Tracker(camera, Config().tracking)
            frames = list(islice(source.frames(start), _LENGTH))
            for frame in frames:
                tracker.track(replace(frame, index=frame.index - start))
            poses = [truth.at(frame.timestamp_s) for frame in frames]
            known = [pose for pose in poses if pose is not None]
            if len(known) == len(poses):
                factors = {"scene": name}
                world = World(
                    camera,
                    list(tracker.history),
                    dict(enumerate(known)),
                    name == _WITHOUT_TRANSLATION,
                    factors,
                    np.zeros((0, 3)),
                )
                yield "film", start, world


def run(worlds: Iterable[tuple[str, int, World]], log: Path | None) -> list[Judged]:
    """Judge the maps of all methods; each is a line of the log at once."""
    found = []
    for source, seed, world in worlds:
        for method in METHODS:
            judged = judge(world, source, seed, method)
            if judged is None:
                continue
            found.append(judged)
            if log is not None:
                with log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(judged)) + "\n")
    return found


def report(judged: Sequence[Judged]) -> str:
    """The tables of some maps: by source, by method and by scene, then the reliability of the risk."""
    groups: dict[str, list[Judged]] = {"all": list(judged)}
    for one in judged:
        groups.setdefault(one.source, []).append(one)
    for one in sorted(judged, key=lambda one: METHODS.index(one.method)):
        groups.setdefault(one.method, []).append(one)
    for one in sorted(judged, key=lambda one: (one.source != "simulated", str(one.factors["scene"]))):
        groups.setdefault(str(one.factors["scene"]), []).append(one)
    rows = [[name, *_counts(group)] for name, group in groups.items()]
    table = markdown_table(
        ["maps", "false", "found", "found %, 95 % interval", "called wrong", "right", "sound", "called wrong",
         "wrong %, 95 % interval", "false stated"],
        rows,
    )  # fmt: skip
    return (
        f"Commit {commit()}. The second figure of a pair has the frames after the map as well; so have intervals and "
        f"the second table.\n\n{table}\n\n{_reliability(judged)}"
    )


def _counts(group: Sequence[Judged]) -> list[str]:
    false, right = [one for one in group if one.false], [one for one in group if not one.false]

    def both(ones: Sequence[Judged], *verdicts: str) -> tuple[int, int]:
        return sum(one.verdict in verdicts for one in ones), sum(one.verdict_later in verdicts for one in ones)

    found, alarms = both(false, "doubtful", "wrong"), both(right, "wrong")
    return [
        str(len(false)),
        _pair(found),
        _interval(found[1], len(false)),
        _pair(both(false, "wrong")),
        str(len(right)),
        _pair(both(right, "sound")),
        _pair(alarms),
        _interval(alarms[1], len(right)),
        f"{sum(one.risk for one in group):.1f} / {sum(one.risk_later for one in group):.1f}",
    ]


def _pair(counts: tuple[int, int]) -> str:
    return f"{counts[0]} / {counts[1]}"


def _interval(count: int, of: int) -> str:
    if not of:
        return "-"
    interval = wilson(count, of)
    return f"{100 * interval.low:.1f} to {100 * interval.high:.1f}"


def _reliability(judged: Sequence[Judged]) -> str:
    rows = []
    for low, high in pairwise(_BINS):
        group = [one for one in judged if low < one.risk_later <= high]
        false = sum(one.false for one in group)
        stated = sum(one.risk_later for one in group)
        rows.append(
            [f"{low:g} to {high:g}", str(len(group)), f"{stated:.2f}", str(false), _interval(false, len(group))]
        )
    return markdown_table(["stated risk", "maps", "false stated", "false", "false %, 95 % interval"], rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.audit", allow_abbrev=False)
    parser.description = "Maps of rival methods under slam_init.audit."
    parser.add_argument("--seeds", type=int, nargs=2, default=(430_000, 430_003), metavar=("FIRST", "END"))
    parser.add_argument("--film", action="store_true", help="starts of films in place of simulated worlds")
    parser.add_argument("--log", type=Path, metavar="FILE", help="append one JSON line a map")
    parser.add_argument("--from-log", type=Path, nargs="+", metavar="FILE", help="the table of logs; run nothing")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table to a file as well")
    options = parser.parse_args(argv)
    if options.from_log:
        lines = [line for path in options.from_log for line in path.read_text(encoding="utf-8").splitlines()]
        judged = [Judged(**json.loads(line)) for line in lines]
    else:
        judged = run(films() if options.film else worlds_of(range(*options.seeds)), options.log)
    show(report(judged) + "\n", options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
