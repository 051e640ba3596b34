"""Starts without their calibration: what the windows of a run find alone, and what all its frames tell together::

    python -m tests.benchmarks.unknown_camera straight strong             the two kinds that windows alone do not solve
    python -m tests.benchmarks.unknown_camera real points drawn --seeds 100 140  others: no false map
    python -m tests.benchmarks.unknown_camera ... --out docs/FILE.md      also writes the lines as a table

A line for each start: the result of the windows alone, then that of the run; the error of the focal length of the map
in per cent with its stated deviation, the largest errors of its rotations and directions, and the frames that were
read. Maps are judged as in a comparison. ``bent`` are real sequences seen through a strong lens (k1 = -.3, k2 = .1):
each frame is resampled.
"""

from __future__ import annotations

import argparse
import math
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from sequences_synth import POINT_SCENES
from slam_init.calibration.prior import prior_camera
from slam_init.compare.judging import criteria_of, group_of_scene
from slam_init.compare.measures import is_correct, pose_errors
from slam_init.config import Config
from slam_init.datasets.opening import open_source
from slam_init.datasets.points import PointSource, open_points
from slam_init.recording.recorder import Recorder
from slam_init.runner import Finished, Job, calibrated_by_motion
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations, TimedSource
from slam_init.types.pose import Trajectory

_DATA = Path(os.environ.get("SLAM_INIT_DATA", "../shared/data"))
_FRAMES = 40
#: Sets of starts: names below the folder of the data with their first frames.
_SETS: dict[str, dict[str, tuple[int, ...]]] = {
    "straight": {"kitti/06_start": (0, 3, 5, 8, 11)},
    "strong": {"planar/checkerboard_desk": (0, 40, 80, 120, 160)},
    "bent": {
        "tsukuba/new_tsukuba_150": (30,),
        "tartanair/hospital_clip": (0,),
        "strecha/castle-P19": (0,),
        "strecha/fountain-P11": (0,),
    },
    "real": {
        "phone/lund_street": (0, 8),
        "panorama/parrington": (0,),
        "euroc/V1_01_static": (0,),
        "middlebury/templeRing_19": (0,),
        "strecha/entry-P10": (0,),
        "7scenes/redkitchen_a": (60, 180),
        "tum_rgbd/fr1_rpy_b": (0, 60),
        "tum_rgbd/fr1_desk_9frames": (0,),
        "lund/door": (0,),
        "tsukuba/new_tsukuba_150": (0, 90),
    },
}
#: Worlds that are drawn, as images or as tracks: the lens of each in turn, then the scene.
_LENSES = ("", "&k1=-0.1", "&lens=radtan")
_K1 = (0.0, -0.1, -0.2)
_SCENES = ("room", "corridor", "nadir", "desk", "pan", "handheld", "tilted-30", "rotation", "wall")


@dataclass(frozen=True)
class Bent:
    """A source whose frames are seen through a lens that bends."""

    source: TimedSource
    camera: Camera

    @staticmethod
    def of(source: TimedSource, k1: float, k2: float) -> Bent:
        """Bend the frames of a source without distortion; no pixel of the new frames lies beyond the old ones."""
        old = source.camera
        assert old is not None
        assert not old.is_distorted
        reach = math.hypot(old.width / 2, old.height / 2) / old.focal_px
        focal_px = old.focal_px / (1 + k1 * reach**2 + k2 * reach**4)
        return Bent(source, replace(old, model="radtan", fx=focal_px, fy=focal_px, distortion=(k1, k2, 0.0, 0.0)))

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """The frames, resampled."""
        assert self.source.camera is not None
        y, x = np.mgrid[: self.camera.height, : self.camera.width]
        rays = self.camera.bearings(np.column_stack([x.ravel(), y.ravel()]).astype(float))
        at = self.source.camera.project(rays).reshape(self.camera.height, self.camera.width, 2).astype(np.float32)
        for frame in self.source.frames(start, max_frames):
            seen: Image = cv2.remap(frame.image, at[..., 0], at[..., 1], cv2.INTER_CUBIC).astype(np.uint8)
            yield replace(frame, image=seen)

    @property
    def name(self) -> str:
        """That of the source."""
        return f"{self.source.name}, bent"

    @property
    def kind(self) -> str:
        """That of the source."""
        return self.source.kind

    @property
    def groundtruth(self) -> Trajectory | None:
        """That of the source."""
        return self.source.groundtruth

    def __len__(self) -> int:
        return len(self.source)


class Tracks(PointSource):
    """Drawn tracks that a run takes in place of its own."""

    def observed(self, frame: Frame, camera: Camera) -> Observations:
        """The tracks of a frame that have a ray."""
        track_ids, pixels = self.sequence.observe(frame.index)
        bearings = camera.bearings(pixels)
        seen = np.isfinite(bearings).all(axis=1)
        return Observations(frame.index, frame.timestamp_s, frame.name, track_ids[seen], pixels[seen], bearings[seen])


def judged(done: Finished, source: TimedSource | Bent | Tracks, group: str) -> tuple[str, str]:
    """The outcome of a run, and its figures in words."""
    map_ = done.result.map
    if map_ is None:
        return "none", str(done.result.reason)
    errors, criteria, true = pose_errors(map_, source.groundtruth), criteria_of(group), source.camera
    outcome = "right" if is_correct(errors, criteria) else "false"
    assert true is not None
    focal = (
        f"f {100 * (map_.camera.focal_px / true.focal_px - 1):+.1f} % +- {100 * (map_.camera.focal_sigma or 0):.1f} %"
    )
    off = ", ".join("-" if one is None else f"{one:.2f}" for one in (errors.rotation_deg, errors.direction_deg))
    return outcome, f"{focal}; {off} deg; {done.result.frames_to_init} frames"


def starts(arguments: argparse.Namespace) -> Iterator[tuple[str, TimedSource | Bent | Tracks, int, str]]:
    """Label, source, first frame and group of all starts."""
    for kind in arguments.sets:
        if kind == "drawn":
            for seed in range(*arguments.seeds):
                scene, lens = _SCENES[seed % len(_SCENES)], _LENSES[seed % len(_LENSES)]
                name = f"synth:{scene}?frames={_FRAMES}{lens}{'&speed=0.3' if scene == 'handheld' else ''}"
                yield f"{name}, seed {seed}", open_source(name, seed), 0, group_of_scene(name)
            continue
        if kind == "points":
            for seed in range(*arguments.seeds):
                scene, k1 = POINT_SCENES[seed % len(POINT_SCENES)], _K1[seed % len(_K1)]
                name = f"points:{scene}?views=20&baseline=0.3&noise_px=0.4&k1={k1}"
                yield f"{name}, seed {seed}", Tracks(open_points(name, seed).sequence), 0, group_of_scene(name)
            continue
        for name, firsts in _SETS[kind].items():
            source: TimedSource | Bent | Tracks = open_source(_DATA / name)
            for first in firsts:
                seen = Bent.of(source, -0.3, 0.1) if kind == "bent" and not isinstance(source, Bent) else source
                yield f"{name}{', bent' * (kind == 'bent')}, {first}", seen, first, name


def main() -> None:
    """Run all starts, and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("sets", nargs="+", choices=[*_SETS, "drawn", "points"])
    parser.add_argument("--seeds", type=int, nargs=2, default=(100, 127))
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    lines = ["| start | windows alone | the run | lens by all frames |", "| --- | --- | --- | --- |"]
    counts: Counter[tuple[str, str]] = Counter()
    for label, source, first, group in starts(arguments):
        true = source.camera
        assert true is not None
        camera = prior_camera((true.width, true.height))
        job = Job(source, camera, Config(), first, _FRAMES, 0, False, (), None, False, False, False)
        done, lens = job.run(Recorder()), "-"
        before = judged(done, source, group)
        after = before
        if (again := calibrated_by_motion(job, done)) is not None:
            found = again.camera
            lens = f"f {100 * (found.focal_px / true.focal_px - 1):+.1f} % +- {100 * (found.focal_sigma or 0):.1f} %"
            lens += f", k {', '.join(f'{k:.3f}' for k in found.distortion[:2]) or 0}"
            after = judged(again.run(Recorder()), source, group)
        counts[before[0], after[0]] += 1
        lines.append(f"| {label} | {': '.join(before)} | {': '.join(after)} | {lens} |")
        print(lines[-1], flush=True)
    total = [
        Counter({name: sum(n for pair, n in counts.items() if pair[k] == name) for name in ("right", "false", "none")})
        for k in (0, 1)
    ]
    summary = "; ".join(" / ".join(str(one[name]) for name in ("right", "false", "none")) for one in total)
    print(f"right / false / none: windows alone, then the run: {summary}")
    if arguments.out is not None:
        arguments.out.write_text(
            "\n".join([*lines, "", f"right / false / none of {sum(counts.values())} starts: {summary}."]) + "\n"
        )


if __name__ == "__main__":
    main()
