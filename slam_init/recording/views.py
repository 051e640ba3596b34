"""The views of a recording: the map, and a pair.

Of the map: landmarks, frusta, the estimated path, and the true path aligned to it. Of a pair: two images side by side,
and the matches as lines between them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr

from slam_init.evaluation.metrics import Similarity, align_truth, positions_between
from slam_init.recording import layout
from slam_init.recording.layout import Color
from slam_init.recording.recorder import PAIR_SIDE_PX, ShownFrame, bgr, match_parts, reduced_shape
from slam_init.types.arrays import Floats, Image
from slam_init.types.camera import Camera
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose, Trajectory
from slam_init.types.result import Attempt
from slam_init.types.scale import Scale

#: At this quality a match can be checked by eye, and a frame of 640x480 pixels takes about 50 kB.
_JPEG_QUALITY = 75
#: Number of dashes of the ground truth. It is dashed so that the estimate can be seen where both agree.
_DASHES = 30
#: The better one of two undecided maps, and the other one.
CONJUGATE_NAMES = ("a", "b")
#: Size of the frustum of the camera in units of the map, whose median depth is 1. On a short path the frusta of the
#: keyframes would hide the path. Their size is then a tenth of the path, so that five of them do not overlap.
FRUSTUM, _SMALLEST_FRUSTUM, _FRUSTUM_OF_PATH = 0.08, 0.005, 0.1
#: Colours of the better one of two undecided maps, and of the other one.
_COLORS: tuple[Color, ...] = ((190, 120, 255), (130, 110, 150))


def jpeg(image: Image) -> Any:
    """Compress an image. OpenCV does this several times faster than Rerun: ``image`` (H, W)."""
    import cv2

    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg")


def dashes(positions: Floats) -> list[Floats]:
    """Cut a path into pieces of equal length, and return every other piece: ``positions`` (N, 3), returns (M, 3)."""
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    cuts = np.linspace(0, along[-1], 2 * _DASHES)
    pieces = []
    for begin, end in cuts.reshape(-1, 2):
        # The corners of the path within a dash are kept.
        at = np.concatenate([[begin], along[(along > begin) & (along < end)], [end]])
        pieces.append(np.stack([np.interp(at, along, column) for column in positions.T], axis=1))
    return pieces


def log_undecided(rec: Any, maps: Sequence[InitialMap]) -> None:
    """Log the paths of two maps, and each map in a space of its own."""
    thick = rr.Radius.ui_points(1.5)
    for k, (map_, name, color) in enumerate(zip(maps, CONJUGATE_NAMES, _COLORS, strict=True)):
        hypothesis, candidate = f"world/trajectory/hypothesis{k + 1}", f"{layout.CANDIDATES}/{name}"
        label = f"map {name.upper()}"
        path = [np.array([keyframe.world_from_cam.t for keyframe in map_.keyframes])]
        rec.log(hypothesis, rr.LineStrips3D(path, colors=[color], radii=thick, labels=[label], show_labels=True))
        rec.log(candidate, rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)
        _log_points(rec, f"{candidate}/points", map_, map_.points)
        for keyframe in map_.keyframes:
            entity = f"{candidate}/keyframes/{keyframe.frame}"
            rec.log(entity, _transform(keyframe.world_from_cam))
            log_pinhole(rec, entity, map_.camera, layout.ESTIMATE_COLOR, FRUSTUM)
        rec.log(f"{candidate}/path", rr.LineStrips3D(path, colors=[_COLORS[0]], radii=thick))


def _log_points(rec: Any, entity: str, map_: InitialMap, points: Floats) -> None:
    rec.log(entity, rr.Points3D(points, colors=map_.colors, radii=rr.Radius.ui_points(2.5)))


#: The entity of the bar.
SCALE_BAR = "world/scale"
_COLOR = (230, 230, 230)
#: Length of the bar in units of the map, at most: the median depth is 1.
_LONGEST = 0.25


def round_length(most: float) -> float:
    """Choose the length of a bar: 1, 2 or 5 times a power of ten, at most a given length."""
    power = 10.0 ** math.floor(math.log10(most))
    return next(factor * power for factor in (5.0, 2.0, 1.0) if factor * power <= most * (1 + 1e-9))


def log_scale_bar(rec: Any, scale: Scale) -> None:
    """Log the bar from the first camera to the right, with its length and the scale as label."""
    if scale.metres_per_unit is None or scale.sigma is None:
        return
    metres = round_length(_LONGEST * scale.metres_per_unit)
    end = metres / scale.metres_per_unit
    label = f"{metres:g} m (1 unit = {scale.metres_per_unit:.4g} m +- {scale.sigma:.1%}, {scale.origin})"
    bar = [[(0.0, 0.0, 0.0), (end, 0.0, 0.0)]]
    rec.log(SCALE_BAR, rr.LineStrips3D(bar, colors=[_COLOR], radii=rr.Radius.ui_points(2.5), labels=[label]))


class MapView:
    """Logs a map when it is accepted, and the path of the camera from then on.

    * ``scale``: Size of the recorded images divided by that of the images as they were read.
    """

    def __init__(self, rec: Any, groundtruth: Trajectory | None, scale: float) -> None:
        self._rec = rec
        self._groundtruth = groundtruth
        self._scale = scale
        self._path: list[Floats] = []
        self._world_from_gt: Similarity | None = None
        self._first_s = 0.0
        self._size = FRUSTUM

    def log(self, map_: InitialMap) -> None:
        """Log the map before and after bundle adjustment, and the errors of the adjustment."""
        rec = self._rec
        poses_after = tuple(keyframe.world_from_cam for keyframe in map_.keyframes)
        path = max(float(np.linalg.norm(pose.t - poses_after[0].t)) for pose in poses_after)
        self._size = float(np.clip(_FRUSTUM_OF_PATH * path, _SMALLEST_FRUSTUM, FRUSTUM))
        rec.set_time("stage", sequence=0)
        self._log_frusta(map_)
        stages = ((map_.points_before, map_.keyframes_before), (map_.points, poses_after))
        for stage, (points, poses) in enumerate(stages):
            rec.set_time("stage", sequence=stage)
            _log_points(rec, "world/points", map_, points)
            for view, pose in zip(map_.keyframes, poses, strict=True):
                rec.log(f"world/keyframes/{view.frame}", _transform(pose))
            self._path = [pose.t for pose in poses]
            self._log_camera(poses[-1])
        if self._groundtruth is not None:
            self._world_from_gt = align_truth(map_.keyframes, self._groundtruth)
            self._first_s = map_.keyframes[0].timestamp_s
            self._log_true_path(map_.keyframes[-1].timestamp_s)
        rec.disable_timeline("stage")

        rec.log(layout.ERROR_BARS, rr.BarChart(np.array(map_.bundle_errors), color=layout.ESTIMATE_COLOR))
        for iteration, error in enumerate(map_.bundle_errors):
            rec.set_time("ba_iter", sequence=iteration)
            rec.log(layout.ERROR, rr.Scalars(error))
        rec.disable_timeline("ba_iter")

    def extend(self, keyframe: Keyframe) -> None:
        """Move the camera, and extend both paths."""
        self._path.append(keyframe.world_from_cam.t)
        self._log_camera(keyframe.world_from_cam)
        self._log_true_path(keyframe.timestamp_s)

    def refine(self, map_: InitialMap) -> None:
        """Log the keyframes and landmarks of a map that has grown."""
        _log_points(self._rec, "world/points", map_, map_.points)
        self._log_frusta(map_)
        for view in map_.keyframes:
            self._rec.log(f"world/keyframes/{view.frame}", _transform(view.world_from_cam))

    def _log_frusta(self, map_: InitialMap) -> None:
        """Without images, since they cover one another on a short path. The view of the pair shows two of them."""
        camera = map_.camera.scaled(self._scale)
        for view in map_.keyframes:
            log_pinhole(self._rec, f"world/keyframes/{view.frame}", camera, layout.ESTIMATE_COLOR, self._size)

    def clear(self) -> None:
        """Forget the map and its paths."""
        self._path, self._world_from_gt = [], None

    def _log_camera(self, world_from_cam: Pose) -> None:
        """Log the pose of the camera, and the estimated path up to it."""
        self._rec.log("world/camera", _transform(world_from_cam))
        self._log_path("est", [np.array(self._path)], layout.ESTIMATE_COLOR)

    def _log_path(self, name: str, strips: Sequence[Floats], color: Color) -> None:
        """Log a trajectory as line strips."""
        # The title of the view explains the colours. Labels in the view would cover one another where the estimate is
        # good. Of two lines in one place, the viewer draws the broader one on top.
        width = rr.Radius.ui_points(1.5 if name == "est" else 2.0)
        self._rec.log(f"world/trajectory/{name}", rr.LineStrips3D(strips, colors=[color], radii=width))

    def _log_true_path(self, last_s: float) -> None:
        """Log the true path from the first keyframe to a time, where it is known and was aligned."""
        if self._groundtruth is not None and self._world_from_gt is not None:
            path = self._world_from_gt.apply(positions_between(self._groundtruth, self._first_s, last_s))
            self._log_path("gt", dashes(path), layout.TRUTH_COLOR)


def log_pinhole(rec: Any, entity: str, camera: Camera, color: Color, size: float, *, static: bool = False) -> None:
    """Log a frustum. It has no lens distortion, so its rays at the border are not exact.

    * ``camera``: Of the recorded images, which are smaller than those that were read.
    """
    thin: Any = rr.Radius.ui_points(1.0)  # its stubs allow numbers only
    pinhole = rr.Pinhole(
        resolution=[camera.width, camera.height],
        focal_length=[camera.fx, camera.fy],
        principal_point=[camera.cx + 0.5, camera.cy + 0.5],
        image_plane_distance=size,
        color=color,
        line_width=thin,
    )
    rec.log(entity, pinhole, static=static)


def _transform(pose: Pose) -> Any:
    return rr.Transform3D(translation=pose.t, mat3x3=pose.R)


# -- a pair ----------------------------------------------------------------------------------------

#: At most this many matches are shown as lines, since more lines cannot be distinguished. All matches are shown as
#: points.
_MAX_LINES = 120
#: Of inliers, outliers, matches on moving objects, and tracks.
_MATCH_COLORS: tuple[Color, ...] = (layout.GREEN, layout.RED, layout.PURPLE, layout.YELLOW)
#: The images of a pair are put one above the other if width divided by height is larger than this.
_WIDE = 1.8


def log_pair(rec: Any, attempt: Attempt, recent: Mapping[int, ShownFrame], camera: Camera) -> None:
    """Log the images and the matches of a pair.

    * ``attempt``: With its matches. Where no motion was estimated, they are neither inliers nor outliers.
    """
    shown = [recent.get(index) for index in attempt.frames[:2]]
    shape = reduced_shape(camera.height, camera.width, PAIR_SIDE_PX)
    blank = np.full((*shape, 3), 40, np.uint8)
    left, right = (blank if one is None else bgr(one.image) for one in shown)
    wide = shape[1] > _WIDE * shape[0]
    rec.log("pairs/image", jpeg(np.concatenate([left, right], axis=0 if wide else 1)))

    factor = shape[1] / camera.width
    second = (0, shape[0]) if wide else (shape[1], 0)
    points1 = (attempt.pixels1 + 0.5) * factor
    points2 = (attempt.pixels2 + 0.5) * factor + second
    matches = np.stack([points1, points2], axis=1)
    sparse = np.arange(len(matches)) % max(1, -(-len(matches) // _MAX_LINES)) == 0
    for (name, chosen), color in zip(match_parts(attempt).items(), _MATCH_COLORS, strict=True):
        entity = f"pairs/image/{name}"
        thin, thick = rr.Radius.ui_points(0.5), rr.Radius.ui_points(1.5)
        rec.log(entity, rr.LineStrips2D(matches[chosen & sparse], colors=[(*color, 150)], radii=thin))
        ends = matches[chosen].reshape(-1, 2)
        rec.log(f"{entity}/points", rr.Points2D(ends, colors=[color], radii=thick))
