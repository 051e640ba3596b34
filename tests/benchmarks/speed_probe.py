"""Measures the checkout whose modules are imported: the program that the speed guard runs for each of two commits.

It uses only what has been there for long: the initializer, the sources, one estimate. It prints one line of JSON: the
CPU time of each task over the least one of the fixed piece of work, which is measured after each task. A task that
fails in this checkout is left out. The program stands alone, because the modules of its own folder belong to another
commit than those that it measures.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path

#: Frames of a sequence, and matches with their outliers of an estimate.
_FRAMES = 60
_MATCHES = ((100, 0.2), (1000, 0.2), (1000, 0.5))
_ESTIMATES = 20

Task = tuple[str, Callable[[], float]]


def _median(values: list[float]) -> float:
    return sorted(values)[len(values) // 2]


def _flow_s() -> float:
    """Least CPU time of the flow of 400 points in an image of 640x480 pixels."""
    import cv2
    import numpy as np

    rng = np.random.default_rng(0)
    large = cv2.resize(rng.integers(0, 255, (60, 80), dtype=np.uint8), (660, 500), interpolation=cv2.INTER_CUBIC)
    before, after = (np.ascontiguousarray(large[y : y + 480, x : x + 640]) for x, y in ((0, 0), (4, 3)))
    points = rng.uniform((40, 40), (600, 440), (400, 2)).astype(np.float32)
    times = []
    for _ in range(15):
        begin = time.thread_time()
        cv2.calcOpticalFlowPyrLK(before, after, points, np.empty_like(points), winSize=(21, 21), maxLevel=3)
        times.append(time.thread_time() - begin)
    return min(times)


def _import_s(module: str) -> float:
    """CPU time of an import in this process, which has imported nothing of the project yet."""
    begin = time.process_time()
    __import__(module)
    return time.process_time() - begin


def _frame_s(name: str) -> float:
    """Median CPU time of a waiting frame of a rendered sequence."""
    from slam_init.datasets import open_source
    from slam_init.initializer import Initializer

    source = open_source(name)
    assert source.camera is not None
    initializer = Initializer(source.camera)
    times = []
    for frame in islice(source.frames(), _FRAMES):
        begin = time.process_time()
        done = initializer.process(frame)
        times.append(time.process_time() - begin)
        if done:
            break
    return _median(times[1:])


def _map_s(name: str) -> float:
    """CPU time of all frames up to the map, judged in whole frames, with the tracks given."""
    from slam_init.config import Config
    from slam_init.datasets.points import open_points
    from slam_init.initializer import Initializer

    source = open_points(name, 0)
    observed = list(source.observations(0))
    times = []
    for _ in range(3):
        initializer = Initializer(source.camera, Config(work_per_frame=None))
        begin = time.process_time()
        for one in observed:
            if initializer.process_tracks(one):
                break
        times.append(time.process_time() - begin)
    return min(times)


def _estimate_s(matches: int, outliers: float) -> float:
    """Median CPU time of an estimate of drawn scenes."""
    import numpy as np

    from quest import estimate_relative_pose

    times = []
    for seed in range(_ESTIMATES + 1):
        rng = np.random.default_rng((7, seed))
        points = rng.uniform((-1, -1, 2), (1, 1, 4), (matches, 3))
        moved = points - (0.2, 0.1, 0.0)
        wrong = rng.uniform(size=matches) < outliers
        moved[wrong] = rng.uniform((-1, -1, 2), (1, 1, 4), (int(wrong.sum()), 3))
        rays = [one + 0.001 * rng.normal(size=one.shape) for one in (points, moved)]
        rays1, rays2 = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in rays)
        begin = time.process_time()
        estimate_relative_pose(rays1, rays2, threshold_rad=4e-3, seed=seed)
        times.append(time.process_time() - begin)
    return _median(times[1:])


def tasks() -> Iterator[Task]:
    """What is measured; the first task imports the project."""
    yield "import slam_init", partial(_import_s, "slam_init")
    for name in ("synth:static", "synth:rotation"):
        yield f"waiting frame, {name}", partial(_frame_s, name)
    for name in ("points:room", "points:wall"):
        yield f"to the map, {name}", partial(_map_s, name)
    for matches, outliers in _MATCHES:
        yield f"estimate, {matches} / {outliers:.0%}", partial(_estimate_s, matches, outliers)


def main(tree: str) -> None:
    """Measure, and print the times."""
    times, flows_s = {}, []
    for name, measured in tasks():
        try:
            times[name] = measured()
        except Exception as error:  # a commit may lack what the task needs
            print(f"{name}: {type(error).__name__}: {error}", file=sys.stderr)
        flows_s.append(_flow_s())
    import slam_init

    found = Path(slam_init.__file__).resolve().parent.parent
    if found != Path(tree).resolve():
        raise RuntimeError(f"the modules of {found} were measured, not those of {tree}")
    print(json.dumps({name: seconds / min(flows_s) for name, seconds in times.items()}))


if __name__ == "__main__":
    main(sys.argv[1])
