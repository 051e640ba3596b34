"""Video made harder, under all methods: ``python -m tests.benchmarks.harder_video --folder DIR``.

Each variant is a copy of real sequences below ``SLAM_INIT_DATA``, in ``DIR/frames/VARIANT``, that
:func:`slam_init.compare.run.compare` evaluates as it evaluates the sequences themselves. The images of ``backward`` run
backward and stand on their heads, so that the rows of a rolling shutter are read in their order: another motion that is
as real. Numbers of the project were chosen on the sequences and not on these copies.
"""

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import cv2
import numpy as np

from slam_init.calibration.files import camera_yaml
from slam_init.compare.rows import TrialRow
from slam_init.compare.run import compare
from slam_init.compare.sources import describe_sources
from slam_init.compare.trials import Plan, Settings
from slam_init.datasets import open_source
from slam_init.output.results import tum_line
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.frame import TimedSource
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose
from tests.benchmarks.options import data_folder, program, progress, show
from tests.benchmarks.tables import markdown_table, read_journal

#: Sequences, with the step between their starts.
SEQUENCES = {
    "tsukuba/new_tsukuba_150": 10,
    "planar/checkerboard_desk": 10,
    "7scenes/redkitchen_a": 20,
    "kitti/06_start": 5,
    "tartanair/hospital_clip": 1,
}
#: Photographs, which have few frames: backward alone.
PHOTOGRAPHS = dict.fromkeys(
    (
        "strecha/castle-P19", "strecha/fountain-P11", "strecha/entry-P10", "lund/door", "middlebury/templeRing_19",
        "phone/lund_street",
    ),
    1,
)  # fmt: skip
_UPSIDE_DOWN = np.diag([1.0, -1.0, 1.0])
_BEST_QUALITY, _LIMIT_FRAMES = 95, 40


@dataclass(frozen=True)
class Variant:
    """What is done to each image, and to the camera."""

    #: ``change(image, following, rng)``: from an image and the one after it.
    change: Callable[[Image, Image, np.random.Generator], Image] = lambda image, _, __: image
    camera: Callable[[Camera], Camera] = lambda camera: camera
    jpeg_quality: int = _BEST_QUALITY
    backward: bool = False


def _scaled(share: float) -> Variant:
    def change(image: Image, _: Image, __: np.random.Generator) -> Image:
        return np.asarray(cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA), np.uint8)

    return Variant(change, lambda camera: camera.scaled(share))


def _dark(image: Image, _: Image, rng: np.random.Generator) -> Image:
    return np.clip(0.35 * image.astype(float) + 10 + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)


def _flickering(image: Image, _: Image, rng: np.random.Generator) -> Image:
    gain, gamma = rng.uniform(0.6, 1.1), rng.uniform(0.6, 1.6)
    return np.clip(255 * gain * (image / 255.0) ** gamma, 0, 255).astype(np.uint8)


def _ghosts(image: Image, following: Image, _: np.random.Generator) -> Image:
    return np.asarray(cv2.addWeighted(image, 0.6, following, 0.4, 0), np.uint8)


def _cut(image: Image, _: Image, __: np.random.Generator) -> Image:
    height, width = image.shape[:2]
    return image[height // 5 : height // 5 + 3 * height // 5, width // 5 : width // 5 + 3 * width // 5]


def _camera_of_cut(camera: Camera) -> Camera:
    width, height = camera.width, camera.height
    cx, cy = camera.cx - width // 5, camera.cy - height // 5
    return replace(camera, width=3 * width // 5, height=3 * height // 5, cx=cx, cy=cy)


def _upside_down(camera: Camera) -> Camera:
    bent = list(camera.distortion)
    if len(bent) > 2:
        bent[2] = -bent[2]  # p1 bends along the rows
    return replace(camera, cy=camera.height - 1 - camera.cy, distortion=tuple(bent))


VARIANTS: dict[str, Variant] = {
    "backward": Variant(lambda image, _, __: image[::-1], _upside_down, backward=True),
    "half the size with JPEG 30": replace(_scaled(0.5), jpeg_quality=30),
    "a quarter of the size": _scaled(0.25),
    "dark and noisy": Variant(_dark),
    "JPEG 12": Variant(jpeg_quality=12),
    "the middle 60 %": Variant(_cut, _camera_of_cut),
    "flicker": Variant(_flickering),
    "ghosts of the next image": Variant(_ghosts),
}


def write(source: TimedSource, variant: Variant, folder: Path, seed: int = 0) -> None:
    """Write a sequence made harder, in the layout of TUM RGB-D."""
    if source.camera is None or source.groundtruth is None:
        raise ValueError(f"{source.name}: give a sequence with a camera and a ground truth")
    rng, frames = np.random.default_rng(seed), list(source.frames())
    frames = frames[::-1] if variant.backward else frames
    begin, end = frames[0].timestamp_s, frames[-1].timestamp_s
    (folder / "images").mkdir(parents=True, exist_ok=True)
    (folder / "camera.yaml").write_text(camera_yaml(variant.camera(source.camera)))
    names, truth = [], []
    for number, frame, following in zip(count(), frames, [*frames[1:], frames[-1]], strict=False):
        time_s = begin + end - frame.timestamp_s if variant.backward else frame.timestamp_s
        time_s -= min(begin, end) if variant.backward else 0.0
        image = variant.change(np.asarray(frame.image), np.asarray(following.image), rng)
        name = f"images/{number:05d}.jpg"
        cv2.imwrite(str(folder / name), np.ascontiguousarray(image), [cv2.IMWRITE_JPEG_QUALITY, variant.jpeg_quality])
        names.append(f"{time_s:.6f} {name}\n")
        pose = source.groundtruth.at(frame.timestamp_s)
        if pose is not None:
            mirrored = Pose(_UPSIDE_DOWN @ pose.R @ _UPSIDE_DOWN, _UPSIDE_DOWN @ pose.t)
            truth.append(tum_line(Keyframe(number, time_s, name, mirrored if variant.backward else pose)))
    (folder / "rgb.txt").write_text("".join(names))
    (folder / "groundtruth.txt").write_text("".join(truth))


def table(rows: Iterable[tuple[str, str, TrialRow]], methods: Sequence[str]) -> str:
    """The table of the variants: correct, false, none and the mean wait of each method.

    * ``rows``: Variant and sequence of each trial.
    """
    cells: dict[tuple[str, str], dict[str, list[TrialRow]]] = {}
    for variant, sequence, row in rows:
        for key in ((variant, sequence), (variant, "all")):
            cells.setdefault(key, {}).setdefault(row.method, []).append(row)
    lines = []
    for (variant, sequence), found in sorted(cells.items(), key=lambda cell: cell[0][1] != "all"):
        message = [_told(found.get(method, [])) for method in methods]
        lines.append([variant, sequence, str(len(next(iter(found.values())))), *message])
    message = [f"{method}: correct/false/none, wait" for method in methods]
    return markdown_table(["", "sequence", "starts", *message], lines)


def _told(rows: Sequence[TrialRow]) -> str:
    if not rows:
        return "-"
    counts = "/".join(str(sum(row.outcome == outcome for row in rows)) for outcome in ("correct", "false", "none"))
    waits = [(row.frames_to_accept or 0) - 1 if row.outcome == "correct" else row.frames_limit for row in rows]
    return f"{counts} {np.mean(waits):.2f}"


def main() -> None:
    """Print the table."""
    parser = program("harder_video", __doc__)
    parser.add_argument("--folder", type=Path, required=True, metavar="DIR", help="of the copies and the trials")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="VARIANT")
    parser.add_argument("--methods", nargs="+", default=["quest", "poselib-100"], metavar="METHOD")
    options = parser.parse_args()
    rows = []
    copies = [
        (variant, name, every)
        for variant in options.variants
        for name, every in (SEQUENCES | (PHOTOGRAPHS if VARIANTS[variant].backward else {})).items()
    ]
    for variant, name, every in progress(copies, "copy"):
        path = data_folder() / name
        if not path.is_dir():
            print(f"no {path}: set SLAM_INIT_DATA to a folder of sequences", file=sys.stderr)
            continue
        # The name of the folder decides how its ground truth is evaluated.
        copy = Path(variant.replace(" ", "-"), path.name)
        folder, results = options.folder / "frames" / copy, options.folder / "trials" / copy
        if not (folder / "groundtruth.txt").exists():
            write(open_source(str(path)), VARIANTS[variant], folder)
        sources, settings = tuple(describe_sources([str(folder)])), Settings(limit_frames=_LIMIT_FRAMES)
        results.parent.mkdir(parents=True, exist_ok=True)
        compare(Plan(sources, tuple(options.methods), every, settings=settings), results, jobs=1, progress=False)
        rows += [(variant, path.name, row) for row in read_journal(results / "trials.jsonl")]
    show(table(rows, options.methods) + "\n", options.out)


if __name__ == "__main__":
    main()
