"""What becomes of a map in the frames after it: ``python -m tests.benchmarks.going_on``.

From every tenth frame of each real sequence below ``SLAM_INIT_DATA`` an initializer finds a map, and 60 further frames
are located in the map that grows (:mod:`slam_init.mapping.growing`). The same is done from the map with true poses and
points fitted to them: the difference is what the first map costs. The same is done on built-in scenes.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TypeAlias

import numpy as np

from slam_init.bundle.least_squares import fit_points, with_lenses
from slam_init.bundle.problem import BundleProblem
from slam_init.config import Config
from slam_init.datasets import open_source
from slam_init.evaluation.metrics import align_positions, align_truth, scale_error
from slam_init.initializer import Initializer
from slam_init.mapping.growing import GrowingMap
from slam_init.types.frame import Observations, Source, length_of
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose, Trajectory
from tests.benchmarks.image_pairs import find_sequences
from tests.benchmarks.options import data_folder, program, progress, show
from tests.benchmarks.tables import markdown_table

#: Frames after the map (two seconds of video), and those in which a loss counts.
_FRAMES, _WATCHED = 60, 40
#: A start without a map after so many frames is given up, as in ``compare``.
_LONGEST_WAIT = 60
_SCENES = ("room", "wall", "corridor", "desk")

#: The tracks of a frame, and the earlier frames that got more with it.
Seen: TypeAlias = tuple[Observations, tuple[Observations, ...]]


@dataclass(frozen=True)
class Row:
    """What became of one map; NaN for what the ground truth does not tell."""

    name: str
    located: int
    frames: int
    lost_after: int | None
    path_error: float
    path_error_true_start: float
    #: E_scale, and E_init in seconds, of eval-vislam; the wait of E_init.
    e_scale: float
    e_init: float
    wait_s: float

    @property
    def lost(self) -> bool:
        """Whether the map was lost while it was watched."""
        return self.lost_after is not None and self.lost_after <= _WATCHED


def follow(name: str, source: Source, start: int) -> Row | None:
    """Initialize from a frame on and go on; None without a map, or without frames after it."""
    if source.camera is None or source.groundtruth is None:
        return None
    initializer, frames = Initializer(source.camera, Config(refine_frames=0)), source.frames(start)
    times = []
    for frame in islice(frames, _LONGEST_WAIT):
        times.append(frame.timestamp_s)
        if initializer.process(frame):
            break
    map_, truth = initializer.map, source.groundtruth
    if map_ is None:
        return None
    seen = []
    for frame in islice(frames, _FRAMES):
        seen.append((initializer.tracker.track(frame), initializer.tracker.revised))
        initializer.tracker.history.forget(keep=())
    if not seen:
        return None
    growing = GrowingMap(map_)
    located = []
    for observed in seen:
        if (one := growing.locate(*observed)) is not None:
            located.append(one.keyframe)
        if growing.lost_at is not None:
            break
    lost_after = None if growing.lost_at is None else sum(one.frame < growing.lost_at for one, _ in seen) + 1
    wait_s = times[-1] - times[0]
    quality = initialization_quality(map_.keyframes, located, truth, wait_s) or (math.nan, math.nan)
    return Row(
        name,
        len(located),
        len(seen),
        lost_after,
        path_error([*map_.keyframes, *located], truth),
        _with_true_start(map_, truth, seen),
        *quality,
        wait_s,
    )


def initialization_quality(
    keyframes: Sequence[Keyframe], located: Sequence[Keyframe], trajectory: Trajectory, wait_s: float
) -> tuple[float, float] | None:
    """Compute the quality of an initialization as eval-vislam does (Li et al., VRIH 2019).

    With ``r`` the scale of the first map over that of all frames, ``E_scale = (|r - 1| + |1 / r - 1|) / 2`` and
    ``E_init = T_init sqrt(E_scale + 0.01)``. Their toolkit takes the first moment from which on the scale of all frames
    so far stays within 20 % of the last one, and subtracts the five seconds at rest with which its sequences begin.
    Here the first map has a frame, so ``T_init`` is the time until then.

    * ``located``: The frames after the map.
    * ``wait_s``: From the first frame to that of the map.
    * Returns: ``E_scale`` and ``E_init`` in seconds. None where the keyframes, or all frames, tell no scale.
    """
    first = scale_error(keyframes, trajectory)
    overall = scale_error([*keyframes, *located], trajectory)
    if first is None or overall is None or min(first, overall) <= -1 or not np.isfinite([first, overall]).all():
        return None
    ratio = (1 + overall) / (1 + first)
    e_scale = 0.5 * (abs(ratio - 1) + abs(1 / ratio - 1))
    return e_scale, wait_s * float(np.sqrt(e_scale + 0.01))


def _with_true_start(map_: InitialMap, truth: Trajectory, seen: Sequence[Seen]) -> float:
    """The error of the path from a map whose poses are the true ones; NaN where not all are known."""
    world = align_truth(map_.keyframes, truth)
    poses = [truth.at(keyframe.timestamp_s) for keyframe in map_.keyframes]
    if world is None or any(pose is None for pose in poses):
        return math.nan
    keyframes = tuple(
        replace(keyframe, world_from_cam=Pose(world.R @ pose.R, world.apply(pose.t)))
        for keyframe, pose in zip(map_.keyframes, poses, strict=True)
        if pose is not None
    )
    problem = BundleProblem(
        frames=tuple(keyframe.frame for keyframe in keyframes),
        world_from_cam=tuple(keyframe.world_from_cam for keyframe in keyframes),
        points=map_.points,
        track_ids=map_.track_ids,
        views=map_.observation_keyframes,
        landmarks=map_.observation_landmarks,
        pixels=map_.observation_pixels,
    )
    fitted = fit_points(with_lenses(map_.camera, problem), map_.noise_px)
    growing = GrowingMap(replace(map_, keyframes=keyframes, points=fitted.points))
    located = [one.keyframe for observed in seen if (one := growing.locate(*observed)) is not None]
    return path_error([*keyframes, *located], truth)


def path_error(views: Sequence[Keyframe], truth: Trajectory) -> float:
    """Root mean square distance from the true positions after a similarity, over the length of the path."""
    pairs = [(view.world_from_cam.t, pose.t) for view in views if (pose := truth.at(view.timestamp_s)) is not None]
    if len(pairs) < 3:
        return math.nan
    estimated, true = (np.array(positions) for positions in zip(*pairs, strict=True))
    length = float(np.sum(np.linalg.norm(np.diff(true, axis=0), axis=1)))
    distances = np.linalg.norm(align_positions(estimated, true).apply(estimated) - true, axis=1)
    return float(np.sqrt(np.mean(distances**2))) / length if length > 0 else math.nan


def runs(every: int) -> Iterator[Row]:
    """The rows of all sequences, then those of the built-in scenes."""
    data = data_folder()
    for name in find_sequences(data):
        source = open_source(str(data / name))
        for start in range(0, length_of(source) or 1, every):
            if (row := follow(name, source, start)) is not None:
                yield row
    for scene in _SCENES:
        for seed in range(5):
            if (row := follow(f"synth:{scene}", open_source(f"synth:{scene}?frames=90", seed=seed), 0)) is not None:
                yield row


def table(rows: Sequence[Row]) -> str:
    """Make the table: a line for each sequence."""
    header = ["sequence", "maps", f"lost within {_WATCHED} frames", "located", "error of the path", "from true poses"]
    header += ["T_init (s)", "E_scale", "E_init (s)"]
    groups = {name: [row for row in rows if row.name == name] for name in dict.fromkeys(row.name for row in rows)}
    return markdown_table(header, [_line(name, group) for name, group in (groups | {"all": list(rows)}).items()])


def _line(name: str, rows: Sequence[Row]) -> list[str]:
    located = f"{sum(row.located for row in rows)} of {sum(row.frames for row in rows)}"
    fields = {
        "path_error": ".2%", "path_error_true_start": ".2%", "wait_s": ".2f", "e_scale": ".2%", "e_init": ".3f",
    }  # fmt: skip
    medians = [_median([getattr(row, field) for row in rows], form) for field, form in fields.items()]
    return [name, str(len(rows)), str(sum(row.lost for row in rows)), located, *medians]


def _median(values: Sequence[float], form: str) -> str:
    known = [value for value in values if math.isfinite(value)]
    return format(float(np.median(known)), form) if known else "-"


def main() -> None:
    """Measure, and print the table."""
    parser = program("going_on", __doc__)
    parser.add_argument("--every", type=int, default=10, help="a start at every N-th frame (default: 10)")
    options = parser.parse_args()
    show(table(list(progress(runs(options.every), "map"))) + "\n", options.out)


if __name__ == "__main__":
    main()
