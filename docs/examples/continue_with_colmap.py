"""Continue from the initial map with COLMAP: it registers further images, starting from our keyframes.

COLMAP needs a pair with 16 degrees of parallax to start. An initial map has less, and its frames are neighbours. So the
map is followed first (:mod:`slam_init.mapping.follower`), and the located frames are known as well. COLMAP then

1. extracts and matches its own features in all chosen images (the database),
2. triangulates them from the known poses (``triangulate_points``),
3. registers the other images and adjusts everything (``incremental_mapping`` with ``input_path``).

Run it as ``python docs/examples/continue_with_colmap.py [SOURCE] [IMAGES]``. It prints how many images were
registered and the error of their positions, beside those of COLMAP's own start from the same database.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.datasets import open_source
from slam_init.errors import SlamInitError
from slam_init.evaluation.metrics import ate_rmse
from slam_init.initializer import Initializer
from slam_init.mapping.follower import follow
from slam_init.output.colmap import pycolmap_reconstruction
from slam_init.recording.recorder import Recorder
from slam_init.types.frame import Frame, Source, length_of
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose, Trajectory

#: Number of images, evenly spaced over the sequence, and of features of each: all pairs are matched.
_IMAGES, _FEATURES = 40, 2000
#: Longest time of a mapper.
_SECONDS = 150
#: Known poses that COLMAP is given, evenly spaced: the first and the last of them have the longest baseline.
_KNOWN = 12


@dataclass(frozen=True, eq=False)
class Registered:
    """What COLMAP made of the images."""

    #: The registered images by name.
    world_from_cam: dict[str, Pose]
    #: Number of images in the database.
    images: int
    #: Number of points of the model.
    points: int
    #: Time of triangulation and mapping, without features and matches.
    seconds: float

    def relative_error(self, truth: Mapping[str, Pose]) -> float | None:
        """Compute the error of the positions after alignment by a similarity.

        * Returns: Root mean square distance over the length of the true path of the registered images; None for fewer
          than three.
        """
        names = sorted(set(self.world_from_cam) & set(truth))
        if len(names) < 3:
            return None
        true = np.array([truth[name].t for name in names])
        path = float(np.sum(np.linalg.norm(np.diff(true, axis=0), axis=1)))
        return ate_rmse(np.array([self.world_from_cam[name].t for name in names]), true) / path


def build_database(map_: InitialMap, frames: Sequence[Frame], work: Path) -> Path:
    """Write images, and extract and match COLMAP's features."""
    import cv2
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value  # its progress would hide the result
    (work / "images").mkdir(parents=True)
    for frame in frames:
        cv2.imwrite(str(work / "images" / image_name(frame.index)), frame.image)
    camera = next(iter(pycolmap_reconstruction(map_).cameras.values()))
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = camera.model_name
    reader.camera_params = camera.params_to_string()
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads, extraction.sift.max_num_features = 1, _FEATURES
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = 1
    database = work / "database.db"
    pycolmap.set_random_seed(0)
    pycolmap.extract_features(
        database,
        work / "images",
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    pycolmap.match_exhaustive(database, matching_options=matching, device=pycolmap.Device.cpu)
    return database


def continue_with_colmap(database: Path, known: Mapping[str, Pose]) -> Registered:
    """Register the images of a database, starting from known poses.

    * Returns: In the world and the unit of the known poses, up to what COLMAP's bundle adjustment moves.
    """
    import pycolmap

    started, options = time.perf_counter(), _options()
    with pycolmap.Database.open(database) as content:
        cache = pycolmap.DatabaseCache.create(
            content, pycolmap.DatabaseCacheOptions(min_num_matches=options.min_num_matches)
        )
    model = pycolmap.Reconstruction()
    model.load(cache)
    for image in list(model.images.values()):
        if image.name in known:
            cam_from_world = known[image.name].inverse()
            frame = model.frame(image.frame_id)
            frame.set_cam_from_world(
                image.camera_id, pycolmap.Rigid3d(pycolmap.Rotation3d(cam_from_world.R), cam_from_world.t)
            )
            model.register_frame(image.frame_id)
    start = database.parent / "known"
    start.mkdir()
    model = pycolmap.triangulate_points(
        model, database, database.parent / "images", start, clear_points=True, options=options
    )
    model.write(start)
    return _mapped(database, options, started, start)


def start_with_colmap(database: Path) -> Registered:
    """Register the images of a database from COLMAP's own initial pair."""
    return _mapped(database, _options(), time.perf_counter(), None)


def _options() -> Any:
    """The options of both starts: those of COLMAP, for a known camera and within a bounded time."""
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.multiple_models, options.min_model_size = False, 3
    options.ba_refine_focal_length = options.ba_refine_extra_params = False
    options.num_threads, options.random_seed, options.max_runtime_seconds = 1, 0, _SECONDS
    return options


def _mapped(database: Path, options: Any, started: float, start: Path | None) -> Registered:
    """Run the mapper; the largest model is the result."""
    import pycolmap

    out = Path(tempfile.mkdtemp(dir=database.parent))
    known = "" if start is None else str(start)  # COLMAP chooses an initial pair where the path is empty
    models = pycolmap.incremental_mapping(database, database.parent / "images", out, options, input_path=known)
    seconds = time.perf_counter() - started
    with pycolmap.Database.open(database) as content:
        images = content.num_images()
    largest = max(models.values(), key=lambda model: model.num_reg_images(), default=None)
    if largest is None:
        return Registered({}, images, 0, seconds)
    poses = {}
    for image_id in largest.reg_image_ids():
        image = largest.image(image_id)
        matrix = image.cam_from_world().inverse().matrix()
        poses[image.name] = Pose(np.array(matrix[:, :3]), np.array(matrix[:, 3]))
    return Registered(poses, images, largest.num_points3D(), seconds)


def image_name(index: int) -> str:
    """Name the image of a frame."""
    return f"{index:06d}.png"


def main(argv: Sequence[str] | None = None) -> int:
    """Initialize from a source, continue with COLMAP, and compare with COLMAP's own start.

    * ``argv``: The source (``synth:room`` by default) and the number of images; the arguments of the process by
      default.
    """
    arguments = sys.argv[1:] if argv is None else argv
    try:
        name = arguments[0] if arguments else "synth:room"
        count = _whole_number(arguments[1]) if len(arguments) > 1 else _IMAGES
        return _main(name, count)
    except SlamInitError as error:
        print(f"continue_with_colmap: {error}", file=sys.stderr)
        return 2


def _whole_number(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not 3 <= int(text[:9]) <= 200:
        raise SlamInitError(f"{text[:40]!r} images: give a number from 3 to 200")
    return int(text)


def _main(name: str, count: int) -> int:
    from importlib.util import find_spec

    if find_spec("pycolmap") is None:
        raise SlamInitError('COLMAP is not installed: pip install ".[colmap]"')
    source = open_source(name)
    if source.camera is None:
        raise SlamInitError(f"{name} has no calibration: give a source with a camera.yaml")
    initializer, frames = Initializer(source.camera), source.frames()
    for frame in frames:
        if initializer.process(frame):
            break
    map_ = initializer.finish().map
    if map_ is None:
        print(f"not initialized: {initializer.result.reason}")
        return 3
    continued = follow(map_, initializer.tracker, frames, None, Recorder(), until_lost=True)
    keyframes = sorted([*map_.keyframes, *continued.keyframes], key=lambda keyframe: keyframe.frame)
    chosen = _chosen(source, keyframes, count)
    with tempfile.TemporaryDirectory() as folder:
        images = [next(source.frames(index, 1)) for index in chosen]
        database = build_database(map_, images, Path(folder) / "work")
        known = {image_name(k.frame): k.world_from_cam for k in keyframes if k.frame in chosen}
        ours, own = continue_with_colmap(database, known), start_with_colmap(database)
    truth = _truth(images, source.groundtruth)
    print(f"map of {len(map_.keyframes)} keyframes, {len(continued.keyframes)} further frames located")
    for title, result in ((f"from our {len(known)} poses", ours), ("COLMAP's own start", own)):
        error = result.relative_error(truth)
        shown = "-" if error is None else f"{100 * error:.2f} % of the path"
        print(
            f"  {title:<20} {len(result.world_from_cam):3d} of {result.images} images, {result.points} points, "
            f"error {shown}, {result.seconds:.1f} s"
        )
    return 0


def _chosen(source: Source, keyframes: Sequence[Keyframe], count: int) -> list[int]:
    """Frames: evenly spaced ones of the whole source, and some of those with known poses."""
    known = [keyframes[i].frame for i in np.unique(np.linspace(0, len(keyframes) - 1, _KNOWN).round().astype(int))]
    length = length_of(source)
    if length is None:
        raise SlamInitError(f"{source.name} has no end: give a folder or a video")
    others = np.unique(np.linspace(0, length - 1, max(count - len(known), 2)).round().astype(int)).tolist()
    return sorted({*known, *others})


def _truth(images: Sequence[Frame], trajectory: Trajectory | None) -> dict[str, Pose]:
    if trajectory is None:
        return {}
    found = ((image_name(frame.index), trajectory.at(frame.timestamp_s)) for frame in images)
    return {name: pose for name, pose in found if pose is not None}


if __name__ == "__main__":
    sys.exit(main())
