"""Joins of two maps of one video, and of maps of different videos::

    python -m tests.benchmarks.joining drawn --worlds 40      rendered worlds
    python -m tests.benchmarks.joining real                   sequences below SLAM_INIT_DATA

The second map begins ``--apart`` frames after the first, from its own start, so that it has another scale and another
frame. A line for each pair: the joined scale over the true one, which the aligned paths of the views tell, its stated
deviation, and the reason where there is none. Then every map is joined with maps of other videos: each such join is
false.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace

import numpy as np

from slam_init.calibration.choosing import camera_of_source
from slam_init.config import Config
from slam_init.datasets.opening import open_source
from slam_init.job import Job
from slam_init.mapping.joining import join
from slam_init.recording.recorder import Recorder
from slam_init.types.frame import TimedSource
from slam_init.types.place import Place

#: The maps wait until their depths are known: a scale is not known better.
_DEPTHS = 0.02
_SCENES = ("room", "desk", "nadir-turn", "wall")


def place_of(source: TimedSource, start: int, grown: int) -> Place | None:
    """The place of the map that starts at a frame and grows by some frames."""
    camera = camera_of_source(source, None, start)
    config = Config()
    acceptance = replace(config.acceptance, max_depth_sigma=_DEPTHS)
    config = replace(config, acceptance=acceptance, refine_frames=grown)
    done = Job(source, camera, config, start, None, 0, False, (), None, False, True, False, True).run(Recorder())
    return done.appearances[0].place if done.appearances else None


def metres_per_unit(place: Place, source: TimedSource) -> float:
    """The scale of a map, by the path of its views."""
    truth = source.groundtruth
    assert truth is not None
    known = [(view, truth.at(float(source.timestamps_s[view.frame]))) for view in place.views]
    found = np.array([view.world_from_cam.t for view, pose in known if pose is not None])
    true = np.array([pose.t for _, pose in known if pose is not None])
    return float(np.linalg.norm(true - true.mean(axis=0)) / np.linalg.norm(found - found.mean(axis=0)))


def main() -> None:
    """Join, and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("kind", choices=["drawn", "real"])
    parser.add_argument("--worlds", type=int, default=40)
    parser.add_argument("--apart", type=int, default=12)
    parser.add_argument("--grown", type=int, default=30)
    parser.add_argument("--false", type=int, default=200, help="joins of maps of different videos")
    parser.add_argument("sources", nargs="*")
    arguments = parser.parse_args()
    if arguments.kind == "drawn":
        names = [
            (f"synth:{_SCENES[k % len(_SCENES)]}?frames=60&width=320&height=240", k) for k in range(arguments.worlds)
        ]
    else:
        names = [(path, 0) for path in arguments.sources]
    places: list[tuple[int, Place]] = []
    right = joined = 0
    for number, (name, seed) in enumerate(names):
        source = open_source(name, seed)
        pair = [place_of(source, start, arguments.grown) for start in (0, arguments.apart)]
        places += [(number, place) for place in pair if place is not None]
        first, second = pair
        if first is None or second is None:
            print(f"{name} {seed}: no map", flush=True)
            continue
        found = join(first, second)
        sizes = f"{len(first.points)} and {len(second.points)} points, {found.inliers} of {found.matches}"
        if found.first_from_second is None:
            print(f"{name} {seed}: {found.reason}, risk {found.risk:.2g}, {sizes}", flush=True)
            continue
        true = metres_per_unit(second, source) / metres_per_unit(first, source)
        error = found.first_from_second.s / true - 1
        joined, right = joined + 1, right + (abs(error) < 0.02)
        print(f"{name} {seed}: scale {error:+.2%}, stated +- {found.scale_sigma:.2%}, {sizes}", flush=True)
    print(f"joined {joined} of {len(names)}, within 2 %: {right}")
    false = tried = 0
    apart = [(a, b) for (m, a), (n, b) in itertools.combinations(places, 2) if m != n]
    for k in np.random.default_rng(0).permutation(len(apart))[: arguments.false]:
        found = join(*apart[int(k)])
        tried, false = tried + 1, false + bool(found)
        if found:
            print(f"false: risk {found.risk:.2g}, {found.inliers} of {found.matches}", flush=True)
    print(f"different videos: {false} of {tried} joined")


if __name__ == "__main__":
    main()
