"""What a run looked like: a recording for the Rerun viewer, written while the run goes on.

Only the modules of the recording import rerun. The pipeline talks to a :class:`Recorder`, which does nothing;
:class:`RerunRecorder` is the same with a file.

==========================  =======================================================================
entity                      content
==========================  =======================================================================
``world``                   frame of the first keyframe (x right, y down, z forward)
``world/camera``            the camera now; its image with keypoints and their motion below
``world/keyframes/K``       the keyframes of the map
``world/points``            the landmarks
``world/trajectory``        ``est`` and ``gt``, the ground truth brought to the map by a similarity;
                            ``hypothesis1``, ``hypothesis2`` while two maps are kept
``pairs``                   the last pair tried: images, matches (green inliers, red outliers), verdict
``stats``                   tracks; what the attempts found, with its gates; error of bundle adjustment
``log``, ``summary``        one line an attempt; the summary of the run
==========================  =======================================================================

Timelines: ``frame`` (absolute index), ``sensor_time``, ``stage`` (the map before, 0, and after, 1, bundle
adjustment), ``ba_iter``. The content depends on the run and its seed alone: no wall clock, no random ids.
"""

from __future__ import annotations

import errno
import os
import uuid
from collections import OrderedDict, deque
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from slam_init.errors import OutputError, SlamInitError
from slam_init.evaluation.metrics import Similarity, align_poses
from slam_init.output.summary import Summary
from slam_init.recording.images import bgr, jpeg, reduced, reduced_shape
from slam_init.recording.layout import ERROR, ERROR_BARS, ESTIMATE_COLOR, SERIES, TRACKS, TRUTH_COLOR, Color, blueprint
from slam_init.recording.paths import dashes, log_hypotheses
from slam_init.recording.text import attempt_line, attempt_markdown, summary_markdown
from slam_init.types.arrays import Floats, Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose, Trajectory
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt

__all__ = ["Recorder", "RerunRecorder"]

_GREEN, _RED, _YELLOW = (60, 200, 90), (230, 70, 70), (255, 200, 40)

#: Images are reduced to this many pixels on their longer side: enough to judge a match by eye, and 300 frames
#: with their tracks stay below 30 MB. Half of it for each image of a pair.
_LONG_SIDE_PX = 640
#: Up to this many frames every image is kept; then every second, third, ...: hours must not fill the disk.
_FRAMES_AT_FULL_RATE = 300
#: Small images kept for pair views; a pair may reach back as far as the window of candidate keyframes.
_MEMORY_FRAMES = 400
#: A keypoint's tail shows its motion over this many frames.
_TAIL_FRAMES = 3
#: More match lines than this are a coloured carpet; all matches are shown as points.
_MAX_LINES = 120
#: Images of a pair wider than this (width by height) are put one above the other.
_WIDE = 1.8
#: Chunks end after this many bytes and never by the clock, so that two runs write the same ones.
_CHUNK_BYTES = 1 << 19
#: Size of the camera's frustum in units of the map, whose median depth is 1. Those of the keyframes are smaller on a
#: short path, which they would hide: this share of it, which keeps five of them apart.
_FRUSTUM, _SMALLEST_FRUSTUM, _FRUSTUM_OF_PATH = 0.08, 0.005, 0.1


class Recorder:
    """Is told what happens and does nothing with it. Also a context manager that closes itself."""

    def frame(self, frame: Frame, observations: Observations) -> None:
        """A frame was read and its tracks followed; what is told next happens at this frame."""

    def attempt(self, attempt: Attempt) -> None:
        """A pair was tried."""

    def initialized(self, map_: InitialMap, observations: Sequence[Observations]) -> None:
        """A map was accepted; the observations are those of its keyframes."""

    def undecided(self, maps: Sequence[InitialMap]) -> None:
        """These maps are kept, as the views could not decide between them; none any more where it is empty."""

    def continued(self, keyframe: Keyframe) -> None:
        """A frame after the initialization was located in the map."""

    def summary(self, summary: Summary) -> None:
        """The run has ended with this summary."""

    def close(self) -> None:
        """Nothing more will be told. May be called twice."""

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class RerunRecorder(Recorder):
    """Writes a ``.rrd`` with its own layout while the run goes on.

    Until it is closed the file is called ``.partial.rrd``, so that what it is to replace is there until then. As a
    context manager left by an error of input or output it leaves nothing.

    Parameters
    ----------
    path : Path
        The file; an existing one is replaced.
    camera : Camera
        Of the frames.
    source_name : str
    groundtruth : Trajectory or None
        Shown beside the estimate once there is one.
    seed : int
        With the source's name it makes the id of the recording.

    Raises
    ------
    OutputError
        Where the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        camera: Camera,
        source_name: str,
        groundtruth: Trajectory | None = None,
        seed: int = 0,
    ) -> None:
        # A run of ours reports to nobody; read when rerun is loaded.
        os.environ.setdefault("RERUN_ANALYTICS", "false")
        import rerun as rr

        # Takes half a second the first time; an interrupt in it must not find the file begun.
        layout = blueprint()
        try:
            # rerun reports a path that it cannot write from another thread, if at all
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            partial = path.with_suffix(".partial.rrd")
            partial.write_bytes(b"")
        except OSError as error:
            raise OutputError(f"cannot write the recording {path}: {error.strerror}: give another --out") from error
        self._rr = rr
        self._path, self._partial = path, partial
        self._camera = camera
        self._groundtruth = groundtruth
        self._scale = min(1.0, _LONG_SIDE_PX / max(camera.width, camera.height))
        self._frames = 0
        self._recent: OrderedDict[int, Image] = OrderedDict()
        self._tails: deque[Observations] = deque(maxlen=_TAIL_FRAMES + 1)
        self._path_est: list[Floats] = []
        self._world_from_gt: Similarity | None = None
        self._first_s = 0.0
        self._hypotheses = 0

        batching = rr.ChunkBatcherConfig.NEVER()
        batching.flush_num_bytes = _CHUNK_BYTES
        source_name = _unicode(source_name)
        identity = uuid.uuid5(uuid.NAMESPACE_URL, f"slam-init/{source_name}/{seed}")
        self._rec = rr.RecordingStream(
            "slam_init", recording_id=identity, send_properties=False, batcher_config=batching
        )
        self._rec.set_log_time_enabled(False)
        self._rec.set_log_tick_enabled(False)
        self._rec.save(partial, default_blueprint=layout)
        self._rec.send_recording_name(f"slam-init {source_name}")
        self._rec.log("world", rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)
        for series in SERIES:
            # Points as well: a single attempt makes no line.
            for style in (rr.SeriesLines, rr.SeriesPoints):
                self._rec.log(series.entity, style(names=series.label, colors=[series.color]), static=True)

    def frame(self, frame: Frame, observations: Observations) -> None:
        """Log the image (reduced), its keypoints and their motion over the last frames."""
        rr, rec = self._rr, self._rec
        rec.set_time("frame", sequence=frame.index)
        rec.set_time("sensor_time", duration=frame.timestamp_s)
        self._recent[frame.index] = reduced(frame.image, _LONG_SIDE_PX // 2)
        if len(self._recent) > _MEMORY_FRAMES:
            self._recent.popitem(last=False)
        if self._frames % (1 + self._frames // _FRAMES_AT_FULL_RATE) == 0:
            rec.log("world/camera/image", jpeg(reduced(frame.image, _LONG_SIDE_PX)))
        self._frames += 1
        if self._frames == 1:
            # Static: an image without its camera is an error in the map, on every timeline.
            self._log_pinhole("world/camera/image", _YELLOW, _FRUSTUM, static=True)

        self._tails.append(observations)
        oldest = self._tails[0]
        _, i, j = np.intersect1d(oldest.track_ids, observations.track_ids, return_indices=True)
        tails = np.stack([oldest.pixels[i], observations.pixels[j]], axis=1)
        rec.log(
            "world/camera/image/motion",
            rr.LineStrips2D(self._shown(tails), colors=[(*_YELLOW, 130)], radii=rr.Radius.ui_points(0.5)),
        )
        rec.log(
            "world/camera/image/keypoints",
            rr.Points2D(self._shown(observations.pixels), colors=[_GREEN], radii=rr.Radius.ui_points(2)),
        )
        rec.log(TRACKS, rr.Scalars(float(len(observations))))

    def attempt(self, attempt: Attempt) -> None:
        """Log the pair with its matches, the verdict with its evidence, and the numbers as series."""
        rr, rec = self._rr, self._rec
        accepted = attempt.verdict == Verdict.ACCEPTED
        level = rr.TextLogLevel.INFO if accepted else rr.TextLogLevel.WARN
        rec.log("log", rr.TextLog(attempt_line(attempt), level=level, color=_GREEN if accepted else _YELLOW))
        rec.log(
            "pairs/verdict",
            rr.TextDocument(attempt_markdown(attempt), media_type=rr.MediaType.MARKDOWN),
        )
        for series in SERIES:
            value = None if series.of_attempt is None else series.of_attempt(attempt)
            if value is not None and np.isfinite(value):
                rec.log(series.entity, rr.Scalars(float(value)))
        self._log_pair(attempt)

    def initialized(self, map_: InitialMap, observations: Sequence[Observations]) -> None:
        """Log the map before and after bundle adjustment, and the ground truth brought to it."""
        rr, rec = self._rr, self._rec
        rec.log(
            "log",
            rr.TextLog(
                f"initialized: {len(map_.keyframes)} keyframes, {len(map_.points)} landmarks, "
                f"{map_.reprojection_rmse_px:.2f} px, {map_.scene} scene",
                level=rr.TextLogLevel.INFO,
                color=_GREEN,
            ),
        )
        self.undecided(())
        poses_after = tuple(keyframe.world_from_cam for keyframe in map_.keyframes)
        path = max(float(np.linalg.norm(pose.t - poses_after[0].t)) for pose in poses_after)
        size = float(np.clip(_FRUSTUM_OF_PATH * path, _SMALLEST_FRUSTUM, _FRUSTUM))
        self._camera = map_.camera
        rec.set_time("stage", sequence=0)
        for view in map_.keyframes:
            # Without their images, which cover one another on a short path; the pair view shows two of them.
            self._log_pinhole(f"world/keyframes/{view.frame}", ESTIMATE_COLOR, size)
        stages = ((map_.points_before, map_.keyframes_before), (map_.points, poses_after))
        for stage, (points, poses) in enumerate(stages):
            rec.set_time("stage", sequence=stage)
            rec.log("world/points", rr.Points3D(points, colors=map_.colors, radii=rr.Radius.ui_points(2.5)))
            for view, pose in zip(map_.keyframes, poses, strict=True):
                rec.log(f"world/keyframes/{view.frame}", _transform(pose))
            self._path_est = [pose.t for pose in poses]
            self._log_camera(poses[-1])
        if self._groundtruth is not None:
            self._log_groundtruth(map_.keyframes, self._groundtruth)
        rec.disable_timeline("stage")

        rec.log(ERROR_BARS, rr.BarChart(np.array(map_.bundle_errors), color=ESTIMATE_COLOR))
        for iteration, error in enumerate(map_.bundle_errors):
            rec.set_time("ba_iter", sequence=iteration)
            rec.log(ERROR, rr.Scalars(error))
        rec.disable_timeline("ba_iter")

    def undecided(self, maps: Sequence[InitialMap]) -> None:
        """Draw the trajectories of the maps, the better one brighter; take away those drawn before."""
        if self._hypotheses or maps:
            log_hypotheses(self._rec, maps)
        self._hypotheses = len(maps)

    def continued(self, keyframe: Keyframe) -> None:
        """Move the camera, and draw both trajectories on."""
        self._path_est.append(keyframe.world_from_cam.t)
        self._log_camera(keyframe.world_from_cam)
        if self._groundtruth is not None and self._world_from_gt is not None:
            self._log_true_path(self._groundtruth, self._world_from_gt, keyframe.timestamp_s)

    def summary(self, summary: Summary) -> None:
        """Log the summary as a table, without the times that no two runs share."""
        rr = self._rr
        document = rr.TextDocument(_unicode(summary_markdown(summary)), media_type=rr.MediaType.MARKDOWN)
        self._rec.log("summary", document, static=True)

    def close(self) -> None:
        """Finish the file and give it its name."""
        self._rec.disconnect()
        if self._partial.exists():
            self._partial.replace(self._path)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close, or after an error of input or output remove the file; what an interrupt cut short is kept."""
        if isinstance(error, SlamInitError):
            self._rec.disconnect()
            self._partial.unlink(missing_ok=True)
        else:
            self.close()

    # -- parts ------------------------------------------------------------------------------------

    def _shown(self, pixels: Floats) -> Floats:
        """Raw pixels (..., 2) in the reduced image; rerun has pixel centres at half-integers."""
        return (pixels + 0.5) * self._scale

    def _log_pinhole(self, entity: str, color: Color, size: float, *, static: bool = False) -> None:
        """A frustum for reduced images. Lens distortion is not drawn: the rays at the border are off."""
        rr, camera = self._rr, self._camera
        small = camera.scaled(self._scale)
        pinhole = rr.Pinhole(
            resolution=[small.width, small.height],
            focal_length=[small.fx, small.fy],
            principal_point=[small.cx + 0.5, small.cy + 0.5],
            image_plane_distance=size,
            color=color,
            line_width=rr.Radius.ui_points(1.0),
        )
        self._rec.log(entity, pinhole, static=static)

    def _log_camera(self, world_from_cam: Pose) -> None:
        self._rec.log("world/camera", _transform(world_from_cam))
        self._log_path("est", [np.array(self._path_est)], ESTIMATE_COLOR)

    def _log_path(self, name: str, strips: Sequence[Floats], color: Color) -> None:
        # The view's title names the colours: labels in space cover one another just where the estimate is good.
        rr = self._rr
        # The broader of two lines at one place is the one that is drawn over the other.
        width = rr.Radius.ui_points(1.5 if name == "est" else 2.0)
        self._rec.log(f"world/trajectory/{name}", rr.LineStrips3D(strips, colors=[color], radii=width))

    def _log_groundtruth(self, keyframes: Sequence[Keyframe], truth: Trajectory) -> None:
        pairs = [(true, k.world_from_cam) for k in keyframes if (true := truth.at(k.timestamp_s)) is not None]
        if len(pairs) < 2:
            return
        self._world_from_gt = align_poses([true for true, _ in pairs], [pose for _, pose in pairs])
        self._first_s = keyframes[0].timestamp_s
        self._log_true_path(truth, self._world_from_gt, keyframes[-1].timestamp_s)

    def _log_true_path(self, truth: Trajectory, world_from_gt: Similarity, last_s: float) -> None:
        times = truth.timestamps_s
        first, last = (int(np.argmin(np.abs(times - t))) for t in (self._first_s, last_s))
        positions = np.array([pose.t for pose in truth.world_from_cam[first : last + 1]])
        self._log_path("gt", dashes(world_from_gt.apply(positions)), TRUTH_COLOR)

    def _log_pair(self, attempt: Attempt) -> None:
        """Two images side by side, and the matches as lines between them."""
        rr, rec = self._rr, self._rec
        images = [self._recent.get(index) for index in attempt.frames[:2]]
        shape = reduced_shape(self._camera.height, self._camera.width, _LONG_SIDE_PX // 2)
        blank = np.full((*shape, 3), 40, np.uint8)
        left, right = (blank if image is None else bgr(image) for image in images)
        wide = shape[1] > _WIDE * shape[0]
        rec.log("pairs/image", jpeg(np.concatenate([left, right], axis=0 if wide else 1)))

        factor = shape[1] / self._camera.width
        second = (0, shape[0]) if wide else (shape[1], 0)
        points1 = (attempt.pixels1 + 0.5) * factor
        points2 = (attempt.pixels2 + 0.5) * factor + second
        matches = np.stack([points1, points2], axis=1)
        step = max(1, -(-len(matches) // _MAX_LINES))
        drawn = np.arange(len(matches)) % step == 0
        for name, chosen, color in (("inliers", attempt.inliers, _GREEN), ("outliers", ~attempt.inliers, _RED)):
            rec.log(
                f"pairs/image/{name}",
                rr.LineStrips2D(matches[chosen & drawn], colors=[(*color, 150)], radii=rr.Radius.ui_points(0.5)),
            )
            rec.log(
                f"pairs/image/{name}/points",
                rr.Points2D(matches[chosen].reshape(-1, 2), colors=[color], radii=rr.Radius.ui_points(1.5)),
            )


def _unicode(text: str) -> str:
    """Text with names as rerun takes it; file systems allow names that are no Unicode."""
    return text.encode("utf-8", "backslashreplace").decode()


def _transform(pose: Pose) -> Any:
    import rerun as rr

    return rr.Transform3D(translation=pose.t, mat3x3=pose.R)
