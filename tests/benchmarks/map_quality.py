"""Bundle adjustment of slam_init compared with that of pycolmap, on the same tracks and from the same start.

In each world ``quest`` finds a map. Its poses before the adjustment are the start of two problems:

``cleaned``
    The observations that slam_init kept, adjusted by least squares. This shows whether slam_init finds the optimum.
``as found``
    All tracks within 2 px of the epipolar geometry of the first and last view, outliers included, triangulated with the
    start poses. slam_init adjusts them with :func:`slam_init.bundle.adjustment.adjust`. pycolmap follows the mapper of
    COLMAP: adjustment with a soft kernel of one pixel, removal of observations beyond 4 px, least squares.

The compared errors are those of rotation and of the direction of the baselines (largest error over the keyframes,
relative to the first keyframe), and the relative error of the depths of the landmarks that both maps contain, after
median alignment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import islice

import numpy as np

from quest.geometry.epipolar import sampson_error
from slam_init.bundle.adjustment import adjust
from slam_init.bundle.problem import BundleProblem, BundleSolution
from slam_init.compare.sources import drawn_sources, open_compared
from slam_init.compare.statistics import restricted_mean
from slam_init.config import Config
from slam_init.datasets.points import PointSource
from slam_init.errors import ConfigError
from slam_init.evaluation.metrics import compare_with_groundtruth
from slam_init.mapping.triangulation import triangulate
from slam_init.mapping.views import table_of
from slam_init.output.tables import markdown_table, number
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose
from tests.benchmarks.study_parts import GENERAL, PLANAR
from tests.benchmarks.study_tables import interval_text

#: Defaults of COLMAP (IncrementalMapperOptions): scale of the soft kernel, threshold of the observation filter.
_SOFT_PX, _FILTER_PX = 1.0, 4.0


@dataclass(frozen=True)
class Errors:
    """Errors of one map: largest rotation and direction error over the keyframes, median relative depth error."""

    rotation_deg: float
    direction_deg: float
    depth: float


def map_quality_table(worlds: int, seed: int, *, progress: bool = False) -> str:
    """Adjust the maps of ``worlds`` worlds with both programs.

    * Returns: The table in markdown: medians over the worlds, and the number of worlds in which slam_init is more
      accurate.
    """
    from tqdm import tqdm

    if find_spec("pycolmap") is None:
        raise ConfigError("the part map-quality needs the package pycolmap: pip install pycolmap")
    found: dict[str, list[tuple[Errors, Errors, Errors]]] = {"cleaned": [], "as found": []}
    with tqdm(total=worlds, unit="map", disable=not progress, leave=False) as bar:
        # Some worlds contain too little information for a map, so more worlds are drawn than maps are needed.
        maps = ((source, _map_of(source, seed)) for source in _worlds(4 * worlds, seed))
        for source, map_ in islice(((source, map_) for source, map_ in maps if map_ is not None), worlds):
            for name, (problem, ours) in posed_problems(source, map_).items():
                theirs = adjusted_by_pycolmap(source.camera, problem, robust=name == "as found")
                shared = np.intersect1d(ours.track_ids, theirs.track_ids)
                at_start, of_ours, of_theirs = (errors_of(source, part, shared) for part in (problem, ours, theirs))
                found[name].append((at_start, of_ours, of_theirs))
            bar.update()
    return _table(found)


def posed_problems(source: PointSource, map_: InitialMap) -> dict[str, tuple[BundleProblem, BundleProblem]]:
    """Return the start and our solution of both problems; without ``as found`` if our adjustment fails."""
    keyframes = map_.keyframes
    frames = tuple(keyframe.frame for keyframe in keyframes)
    cleaned = BundleProblem(
        frames=frames,
        world_from_cam=map_.keyframes_before,
        points=map_.points_before,
        track_ids=map_.track_ids,
        views=map_.observation_keyframes,
        landmarks=map_.observation_landmarks,
        pixels=map_.observation_pixels,
    )
    ours = replace(cleaned, world_from_cam=tuple(k.world_from_cam for k in keyframes), points=map_.points)
    problems = {"cleaned": (cleaned, ours)}
    start = _as_found(source, frames, map_.keyframes_before)
    solution = adjust(source.camera, start, Config().map)
    if isinstance(solution, BundleSolution):
        problems["as found"] = start, solution.problem
    return problems


def adjusted_by_pycolmap(camera: Camera, problem: BundleProblem, *, robust: bool) -> BundleProblem:
    """Adjust a problem with pycolmap; the calibration is fixed."""
    if robust:
        soft = _solve(camera, problem, soft=True)
        # Residuals of points behind a camera are NaN; they do not count as inliers.
        inlying: Bools = np.asarray(np.linalg.norm(soft.residuals(camera), axis=1) < _FILTER_PX)
        problem = soft.keep(inlying)
    return _solve(camera, problem, soft=False)


def errors_of(source: PointSource, problem: BundleProblem, track_ids: Ints) -> Errors:
    """Compute the errors of the poses, and of the depths of these tracks in the first view."""
    keyframes = tuple(
        Keyframe(frame, float(source.timestamps_s[frame]), "", pose)
        for frame, pose in zip(problem.frames, problem.world_from_cam, strict=True)
    )
    errors = compare_with_groundtruth(keyframes, source.groundtruth)
    rotation_deg = None if errors is None else errors.rotation_error_deg
    direction_deg = None if errors is None else errors.direction_error_deg
    _, rows, _ = np.intersect1d(problem.track_ids, track_ids, return_indices=True)
    depth = problem.world_from_cam[0].inverse().apply(problem.points[rows])[:, 2]
    ratio = depth / source.sequence.depths(problem.frames[0])[problem.track_ids[rows]]
    ratio = ratio[np.isfinite(ratio)]  # outliers have no true depth
    return Errors(
        rotation_deg=float("nan") if rotation_deg is None else rotation_deg,
        direction_deg=float("nan") if direction_deg is None else direction_deg,
        depth=float(np.median(np.abs(ratio / np.median(ratio) - 1))),
    )


def _worlds(count: int, seed: int) -> Iterator[PointSource]:
    """Return sources; the scenes alternate."""
    each = [drawn_sources(scene, count, seed, focal_error=0.0) for scene in (*GENERAL, *PLANAR)]
    texts = (text for texts in zip(*each, strict=True) for text in texts)
    return (opened_points(text) for text in islice(texts, count))


def opened_points(text: str) -> PointSource:
    """Open a source of points."""
    source = open_compared(text)
    if not isinstance(source, PointSource):
        raise TypeError(f"{text} is not a source of points")
    return source


def _map_of(source: PointSource, seed: int) -> InitialMap | None:
    from slam_init.initializer import Initializer

    initializer = Initializer(source.camera, Config(seed=seed))
    for observations in source.observations():
        if initializer.process_tracks(observations):
            break
    return initializer.finish().map


def _as_found(source: PointSource, frames: tuple[int, ...], world_from_cam: tuple[Pose, ...]) -> BundleProblem:
    views = {o.frame: o for o in source.observations() if o.frame in frames}
    first, last = views[frames[0]], views[frames[-1]]
    table = table_of(first, last, [views[frame] for frame in frames[1:-1]])
    order = [0, *range(2, len(frames)), 1]  # the first two rows of the table are the pair
    bearings, pixels = table.bearings[order], table.pixels[order]
    points = triangulate(list(world_from_cam), bearings)
    last_from_first = world_from_cam[-1].inverse() @ world_from_cam[0]
    error_rad = np.abs(sampson_error(last_from_first.R, last_from_first.t, bearings[0], bearings[-1]))
    usable = np.isfinite(points).all(axis=1)
    usable &= error_rad < Config().two_view.threshold_px / source.camera.focal_px
    for pose in world_from_cam:
        usable &= pose.inverse().apply(points)[:, 2] > 0
    kept = np.flatnonzero(usable)
    seen, landmark = np.nonzero(np.isfinite(pixels[:, kept, 0]))
    return BundleProblem(
        frames=frames,
        world_from_cam=world_from_cam,
        points=points[kept],
        track_ids=table.track_ids[kept],
        views=seen.astype(np.int64),
        landmarks=landmark.astype(np.int64),
        pixels=pixels[:, kept][seen, landmark],
    )


def _solve(camera: Camera, problem: BundleProblem, *, soft: bool) -> BundleProblem:
    import pycolmap

    model = pycolmap.Reconstruction()
    parameters = [camera.fx, camera.fy, camera.cx, camera.cy]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model="PINHOLE", width=camera.width, height=camera.height, params=parameters, camera_id=1)
    )
    row = np.zeros(len(problem.views), np.int64)  # index of an observation within its image
    for k, pose in enumerate(problem.world_from_cam):
        mine = np.flatnonzero(problem.views == k)
        row[mine] = np.arange(len(mine))
        image = pycolmap.Image(name=str(k), keypoints=problem.pixels[mine], camera_id=1, image_id=k + 1)
        inverse = pose.inverse()
        rotation = pycolmap.Rotation3d(inverse.R)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(rotation, inverse.t))
    tracks = [pycolmap.Track() for _ in problem.points]
    for view, landmark, at in zip(problem.views.tolist(), problem.landmarks.tolist(), row.tolist(), strict=True):
        tracks[landmark].add_element(view + 1, at)
    identifiers = [model.add_point3D(X, track) for X, track in zip(problem.points, tracks, strict=True)]
    options = pycolmap.BundleAdjustmentOptions(
        refine_focal_length=False, refine_extra_params=False, refine_sensor_from_rig=False, print_summary=False
    )
    options.ceres.solver_options.num_threads = 1
    if soft:
        options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
        options.ceres.loss_function_scale = _SOFT_PX
    config = pycolmap.BundleAdjustmentConfig()
    for k in range(len(problem.frames)):
        config.add_image(k + 1)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    found = [model.images[k + 1].cam_from_world() for k in range(len(problem.frames))]
    poses = tuple(Pose(pose.rotation.matrix(), np.asarray(pose.translation)).inverse() for pose in found)
    points: Floats = np.array([model.points3D[identifier].xyz for identifier in identifiers]).reshape(-1, 3)
    return replace(problem, world_from_cam=poses, points=points)


def _table(found: dict[str, list[tuple[Errors, Errors, Errors]]]) -> str:
    header = ["problem", "figure", "worlds", "start", "ours", "pycolmap", "ours / pycolmap", "ours better"]
    lines = []
    for name, errors in found.items():
        for figure, what, scale in (
            ("rotation_deg", "rotation (deg)", 1.0),
            ("direction_deg", "direction (deg)", 1.0),
            ("depth", "depth error (%)", 100.0),
        ):
            values = scale * np.array([[getattr(one, figure) for one in three] for three in errors]).reshape(-1, 3)
            medians = np.median(values, axis=0) if len(values) else np.full(3, np.nan)
            lines.append(
                [
                    name if figure == "rotation_deg" else "",
                    what,
                    str(len(values)),
                    *(number(float(value), 4) for value in medians),
                    _ratio(values[:, 1], values[:, 2]),
                    f"{int(np.sum(values[:, 1] < values[:, 2]))} of {len(values)}",
                ]
            )
    return markdown_table(header, lines)


def _ratio(ours: Floats, theirs: Floats) -> str:
    """Return the geometric mean of the ratio with its 95 % interval."""
    logs: Sequence[float] = np.log(ours / theirs).tolist()
    mean = restricted_mean(logs, [float("inf")] * len(logs))
    return interval_text(type(mean)(*np.exp([mean.value, mean.low, mean.high]).tolist()), 1.0, 3)
