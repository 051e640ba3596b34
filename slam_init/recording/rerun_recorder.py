"""The recording of a run for the Rerun viewer, written during the run.

==========================  =======================================================================
entity                      content
==========================  =======================================================================
``world``                   frame of the first keyframe (x right, y down, z forward)
``world/camera``            the current camera; its image with keypoints and their motion below. While there is
                            no map it turns in the axes of the first camera
``world/keyframes/K``       the keyframes of the map
``world/points``            the landmarks
``world/trajectory``        ``est`` and ``gt``, the ground truth aligned to the map by a similarity;
                            ``hypothesis1``, ``hypothesis2`` while two maps are kept
``candidates/a``, ``/b``    both undecided maps while they are kept, the better one first
``candidates/evidence``     what has to decide between them
``pairs``                   the last pair tried: images, matches (green inliers, red outliers,
                            purple on a moving object, yellow where no motion was estimated),
                            verdict and evidence
``stats``                   number of tracks; figures of the attempts; the risk, its terms and its
                            bound as powers of ten; time of a frame; error of bundle adjustment
``log``                     one line for each attempt
``advice``                  the result of the run in large letters, and its notes
==========================  =======================================================================

Timelines: ``frame`` (absolute index), ``sensor_time`` or, where the stamps are dates, ``sensor_date`` and
``ros2_timestamp``, ``stage`` (0 for the map before bundle adjustment, 1 after it), ``ba_iter``. The content depends on
the run and its seed only: it has no wall clock and no random ids.
"""

from __future__ import annotations

import errno
import os
import shutil
import uuid
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from slam_init.errors import SlamInitError, plain_line
from slam_init.output.folder import writing
from slam_init.output.names import UNFINISHED
from slam_init.output.summary import Summary
from slam_init.recording import layout, text, views
from slam_init.recording.layout import GREEN, PURPLE, YELLOW, End
from slam_init.recording.recorder import LONG_SIDE_PX, Recorder, StoryRecorder, moving_matches, reduced
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Trajectory
from slam_init.types.refusal import Verdict
from slam_init.types.result import Attempt
from slam_init.types.scale import Scale
from slam_init.types.status import CameraPose
from slam_init.types.time_stamps import is_date

_NOWHERE = np.zeros((0, 2))

#: Each image is kept up to this many frames, then every second image, then every third one, and so on. So a video of
#: hours does not fill the disk.
FRAMES_AT_FULL_RATE = 300
#: The line at a keypoint shows its motion over this many frames.
_TAIL_FRAMES = 3
_CHUNK_BYTES = 1 << 19
#: Space that a recording leaves on its disk: the chunks that Rerun has not written yet.
_RESERVE_BYTES = 16 * _CHUNK_BYTES


def _stream(identity: str, viewer: str | None) -> rr.RecordingStream:
    """Open a stream without a wall clock and with an id that depends on its arguments only.

    A chunk ends after a number of bytes and never after a time, so that two equal runs write equal chunks. For a
    viewer that shows the stream while it is made, chunks end by time.
    """
    batching = rr.ChunkBatcherConfig.NEVER() if viewer is None else rr.ChunkBatcherConfig.LOW_LATENCY()
    if viewer is None:
        batching.flush_num_bytes = _CHUNK_BYTES
    name = uuid.uuid5(uuid.NAMESPACE_URL, identity)
    rec = rr.RecordingStream("slam_init", recording_id=name, send_properties=False, batcher_config=batching)
    rec.set_log_time_enabled(False)
    rec.set_log_tick_enabled(False)
    return rec


class RerunRecorder(Recorder):
    """Writes a ``.rrd`` file with a layout for the viewer during the run.

    The file is called ``.partial.rrd`` until it is closed, so that an earlier file stays until then. If a ``with``
    statement ends with a :class:`SlamInitError`, the partial file is removed. Rerun reports a full disk in its log
    only, and a flush may then wait without end. So the space of the disk is looked up with each frame, and a recording
    ends with an error before the disk is full.

    * ``path``: The file; an existing one is replaced.
    * ``camera``: The calibration of the frames.
    * ``source_name``: Name of the source; the name of the recording contains it.
    * ``groundtruth``: It is shown beside the estimate, once there is a map.
    * ``seed``: Seed of the run. The id of the recording depends on the name of the source and the seed.
    * ``viewer``: Address of a viewer that shows the recording while it is made. The file then depends on the time,
      since its data are cut into chunks by time.
    * ``story``: What ``overview.png`` shows of the run.
    """

    def __init__(
        self,
        path: Path,
        camera: Camera,
        source_name: str,
        groundtruth: Trajectory | None = None,
        seed: int = 0,
        viewer: str | None = None,
    ) -> None:
        # The first call takes half a second. It comes before the file is created, in case of an interrupt.
        start = layout.blueprint()
        self._camera = camera
        self._scale = min(1.0, LONG_SIDE_PX / max(camera.width, camera.height))
        self._frames = 0
        self.story = StoryRecorder()
        self._attempt: Attempt | None = None
        self._moving = False
        self._end, self._rolling = End.MAP, False

        source_name = plain_line(source_name)
        self._rec = _stream(f"slam-init/{source_name}/{seed}", viewer)
        self._map_view = views.MapView(self._rec, groundtruth, self._scale)
        self._path, self._partial, self._is_open = path, path.with_suffix(UNFINISHED), True
        with self._writing():
            if path.is_dir():
                raise IsADirectoryError(f"{path} is a folder")
            self._check_room()
            self._partial.touch()
        sinks = [] if viewer is None else [rr.GrpcSink(viewer)]
        self._rec.set_sinks(rr.FileSink(str(self._partial)), *sinks, default_blueprint=start)
        self._rec.send_recording_name(f"slam-init {source_name}")
        self._rec.log("world", rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)
        for series in layout.SERIES:
            # Points are shown as well, since a single attempt makes no line.
            for style in (rr.SeriesLines, rr.SeriesPoints):
                self._rec.log(series.entity, style(names=series.label, colors=[series.color]), static=True)

    def frame(self, frame: Frame, observations: Observations) -> None:
        """Log the reduced image, its keypoints, and their motion over the last frames."""
        rec = self._rec
        self._check_file()
        rec.set_time("frame", sequence=frame.index)
        # Bags and cameras log dates; times from a start of the clock are no dates, and have no day.
        if is_date(frame.timestamp_s):
            rec.set_time("sensor_date", timestamp=frame.timestamp_s)
            rec.set_time("ros2_timestamp", timestamp=frame.timestamp_s)  # that of Rerun's reader of bags
        else:
            rec.set_time("sensor_time", duration=frame.timestamp_s)
        self.story.frame(frame, observations)
        if self._frames % (1 + self._frames // FRAMES_AT_FULL_RATE) == 0:
            rec.log("world/camera/image", views.jpeg(reduced(frame.image, LONG_SIDE_PX)))
        self._frames += 1
        if self._moving:
            self._log_moving(_NOWHERE)
        if self._frames == 1:
            # Logged as static, because the viewer reports an error for an image without a camera on any timeline.
            small = self._camera.scaled(self._scale)
            views.log_pinhole(rec, "world/camera/image", small, YELLOW, views.FRUSTUM, static=True)

        oldest = list(self.story.recent.values())[-_TAIL_FRAMES - 1 :][0]
        _, i, j = np.intersect1d(oldest.track_ids, observations.track_ids, return_indices=True)
        tails = np.stack([oldest.pixels[i], observations.pixels[j]], axis=1)
        thin = rr.Radius.ui_points(0.5)
        motion = rr.LineStrips2D(self._shown(tails), colors=[(*YELLOW, 130)], radii=thin)
        rec.log("world/camera/image/motion", motion)
        self._log_pixels("world/camera/image/keypoints", observations.pixels, GREEN, 2)
        rec.log(layout.TRACKS, rr.Scalars(float(len(observations))))

    def attempt(self, attempt: Attempt) -> None:
        """Log the pair with its matches, the verdict with its evidence, and the figures as series."""
        self._log_line(text.attempt_line(attempt), good=attempt.verdict == Verdict.ACCEPTED)
        self._log_text("pairs/verdict", text.attempt_markdown(attempt))
        self._log_text("pairs/evidence", text.evidence_markdown(attempt))
        for series in layout.SERIES:
            value = None if series.of_attempt is None else series.of_attempt(attempt)
            if value is not None and np.isfinite(value):
                self._rec.log(series.entity, rr.Scalars(float(value)))
        self.story.attempt(attempt)
        views.log_pair(self._rec, attempt, self.story.recent, self._camera)
        self._attempt = attempt
        if attempt.frames[1:2] == tuple(self.story.recent)[-1:]:
            self._log_moving(attempt.pixels2[moving_matches(attempt)])

    def frame_time(self, elapsed_ms: float) -> None:
        """Log what a frame took, beside the time between two frames at 30 Hz."""
        self._rec.log(layout.FRAME_TIME, rr.Scalars(elapsed_ms))
        self._rec.log(layout.FRAME_BUDGET, rr.Scalars(layout.BUDGET_MS))

    def row_times(self, observations: Observations, corrected: Floats) -> None:
        """Log arrows from the raw pixels to the corrected ones: ``corrected`` (N, 2)."""
        moved = layout.ARROW_FACTOR * (corrected - observations.pixels) * self._scale
        before = self._shown(observations.pixels)
        arrows = rr.Arrows2D(origins=before, vectors=moved, colors=[(*PURPLE, 150)], radii=rr.Radius.ui_points(0.8))
        self._rec.log(layout.ARROWS, arrows)
        self._log_pixels(f"{layout.ARROWS}/before", observations.pixels, YELLOW, 3)
        self._log_pixels(f"{layout.ARROWS}/after", corrected, PURPLE, 1.5, draw_order=50.0)
        self._rolling = True

    def waiting(self, pose: CameraPose) -> None:
        """Turn the camera in the axes of the first one. Its place is not shown: its unit changes with the pair."""
        self._rec.log("world/camera", rr.Transform3D(mat3x3=pose.cam_from_first.T))
        self._rec.log(layout.ROTATION_SIGMA, rr.Scalars(pose.rotation_sigma_deg))

    def initialized(self, map_: InitialMap, observations: Sequence[Observations]) -> None:
        """Log the map before and after bundle adjustment, and the ground truth aligned to it."""
        self._log_line(
            f"initialized: {len(map_.keyframes)} keyframes, {len(map_.points)} landmarks, "
            f"{map_.reprojection_rmse_px:.2f} px, {map_.scene} scene"
        )
        self.story.initialized(map_, observations)
        self._end, self._rolling = End.MAP, False
        self._camera = map_.camera
        self._map_view.log(map_)

    def undecided(self, maps: Sequence[InitialMap]) -> None:
        """Draw both maps with their paths."""
        views.log_undecided(self._rec, maps)
        self._log_text(f"{layout.CANDIDATES}/evidence", text.conjugate_maps_markdown(self._attempt))
        self._end = End.CANDIDATES

    def continued(self, keyframe: Keyframe) -> None:
        """Move the camera, and extend both trajectories."""
        self._map_view.extend(keyframe)

    def refined(self, map_: InitialMap) -> None:
        """Draw the keyframes and landmarks of the grown map."""
        self._log_line(f"the map has grown: {len(map_.keyframes)} keyframes, {len(map_.points)} landmarks")
        self._map_view.refine(map_)

    def scaled(self, scale: Scale) -> None:
        """Draw a bar of a round length in metres at the first keyframe; the scene stays in units of the map."""
        views.log_scale_bar(self._rec, scale)

    def restarted(self) -> None:
        """Clear the lost map. The next one has another world frame."""
        self._log_line("the map was lost: restarting", good=False)
        for entity in ("world/keyframes", "world/points", "world/trajectory", views.SCALE_BAR):
            self._rec.log(entity, rr.Clear(recursive=True))
        self._map_view.clear()

    def summary(self, summary: Summary) -> None:
        """Log the result of the run, with its notes."""
        self._log_text(layout.ADVICE, text.advice_markdown(summary), static=True)
        if summary.reason is not None and self._end is End.MAP:
            self._end = End.NO_MAP

    def close(self) -> None:
        """Write the rest, close the file, and give it its name. It may be called twice."""
        if not self._is_open:
            return
        if self._end is not End.MAP or self._rolling:
            # The layout that the file began with shows a map. The viewer takes the last layout of a file.
            rr.send_blueprint(layout.blueprint(self._end, rolling=self._rolling), recording=self._rec)
        try:
            self._check_file()
            self._rec.disconnect()
            with self._writing():
                self._partial.replace(self._path)
        finally:
            self._discard()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Close the file; after a :class:`SlamInitError`, or an interrupt before the first frame, remove it."""
        if isinstance(error, SlamInitError) or (error is not None and not self._frames):
            self._discard()
        else:
            self.close()

    # -- the file -----------------------------------------------------------------------------------

    def _writing(self) -> AbstractContextManager[None]:
        return writing(f"the recording {self._path}", "give another --out")

    def _check_room(self) -> None:
        if shutil.disk_usage(self._path.parent).free < _RESERVE_BYTES:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _check_file(self) -> None:
        """Raise an error where the disk is full, or the file is gone."""
        with self._writing():
            if self._is_open and not self._partial.exists():
                raise FileNotFoundError("the file is gone")
            self._check_room()

    def _discard(self) -> None:
        """Close the file, and remove it unless it is complete."""
        if self._is_open:
            self._rec.disconnect()
        self._is_open = False
        with suppress(OSError):
            self._partial.unlink(missing_ok=True)

    # -- parts of the recording -------------------------------------------------------------------

    def _log_line(self, line: str, *, good: bool = True) -> None:
        levels = rr.TextLogLevel
        level, color = (levels.INFO, GREEN) if good else (levels.WARN, YELLOW)
        self._rec.log("log", rr.TextLog(line, level=level, color=color))

    def _log_text(self, entity: str, markdown: str, *, static: bool = False) -> None:
        self._rec.log(entity, rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN), static=static)

    def _log_moving(self, pixels: Floats) -> None:
        """Draw the tracks of the frame that lie on moving objects."""
        self._moving = len(pixels) > 0
        self._log_pixels("world/camera/image/moving", pixels, PURPLE, 3, draw_order=60.0)

    def _log_pixels(
        self, entity: str, pixels: Floats, color: layout.Color, radius: float, draw_order: float | None = None
    ) -> None:
        """Draw raw pixels as points: ``pixels`` (N, 2)."""
        radii = rr.Radius.ui_points(radius)
        points = rr.Points2D(self._shown(pixels), colors=[color], radii=radii, draw_order=draw_order)
        self._rec.log(entity, points)

    def _shown(self, pixels: Floats) -> Any:
        """Convert raw pixels (..., 2) to the reduced image. In Rerun, pixel centres are at half-integers."""
        return (pixels + 0.5) * self._scale
