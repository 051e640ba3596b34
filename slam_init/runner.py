"""One run, from a source to the files of its results: initialize, follow the map, restart where it is lost."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from slam_init.calibration.files import GivenCamera, camera_of_metadata, camera_of_source
from slam_init.config import Config, config_toml
from slam_init.datasets.inertial import Gyroscope, InertialSensor, StepRotations, gyroscope_of, inertial_of
from slam_init.datasets.live import without_password
from slam_init.datasets.track_source import TrackProvider
from slam_init.errors import ConfigError, OutputError, SlamInitError, SourceError, check_type
from slam_init.evaluation.metrics import compare_with_groundtruth, scale_error
from slam_init.frontend.orb import FrameMemory, describe_landmarks
from slam_init.initializer import FittedPoses, Initializer
from slam_init.mapping.follower import Continuation, FrameTracker, follow
from slam_init.mapping.reduction import Reduction
from slam_init.methods import make_initializer
from slam_init.methods.external_command import is_external
from slam_init.methods.registry import method_info
from slam_init.methods.self_calibration import LONGEST_STRETCH, by_all_frames, calibrate, combine
from slam_init.output.colmap import colmap_note
from slam_init.output.folder import OutputFolder
from slam_init.output.names import INTERRUPTED, OVERVIEW, RECORDING, segment_folder
from slam_init.output.plain_json import Json, plain_fields
from slam_init.output.results import maps_of, publish_results
from slam_init.output.scene import check_formats, stage
from slam_init.output.summary import InputHash, SegmentRecord, SourceRecord, Summary, provenance_of, summary_of
from slam_init.pictures.overview import overview_png
from slam_init.recording.recorder import Recorder
from slam_init.scale.find import find_scale
from slam_init.scale.metric_map import in_metres, scaled_keyframes
from slam_init.scale.requests import KnownBoard, KnownMarkers, MeasuredMotion, ScaleRequest
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations, Source, length_of, notes_of
from slam_init.types.history import History
from slam_init.types.inertial import InertialRecord
from slam_init.types.initial_map import Descriptors, InitialMap, Keyframe
from slam_init.types.lens import CALIBRATED_SIGMA
from slam_init.types.refusal import Verdict, in_words
from slam_init.types.result import MAX_SEGMENTS, GroundTruthErrors, Result, Segment
from slam_init.types.scale import ScaleOrigin
from slam_init.types.status import Status


def run(
    source: Source,
    camera: GivenCamera = None,
    config: Config | None = None,
    *,
    out: str | os.PathLike[str] | None = None,
    start: int = 0,
    max_frames: int | None = None,
    continue_frames: int | None = None,
    progress: bool = False,
    overview: bool = True,
    viewer: str | None = None,
    scale: ScaleRequest | None = None,
    restart: bool = False,
    imu: bool | InertialSensor = False,
    export: Collection[str] = (),
) -> tuple[Result, Summary]:
    """Initialize from a source, and write the results.

    Parameters
    ----------
    source : Source
        From :func:`slam_init.open_source`.
    camera : Camera, (3, 3) array_like or None
        The calibration of the frames, or its matrix K. By default that of the source; without one the focal length is
        that of the metadata of the files, or is estimated.
    config : Config, optional
        All options.
    out : str or path, optional
        Folder of the results and of the recording (see :mod:`slam_init.output.results`): a new or an empty one, or one
        of an earlier run. Without it nothing is written. After an interrupt it holds the earlier results, and the
        recording so far as ``interrupted.rrd``.
    start : int
        Absolute index of the first frame.
    max_frames : int, optional
        Largest number of frames until the initialization.
    continue_frames : int, optional
        Number of frames after the initialization that are located in the map: none by default. With ``restart``, the
        number of frames that are read after the first map: all by default.
    progress : bool
        Show a progress bar on stderr.
    overview : bool
        Draw ``overview.png``. An interrupted run has none.
    viewer : str, optional
        Address of a Rerun viewer that shows the recording while it is made, as of
        :func:`slam_init.recording.viewer.viewer_url`. It needs ``out``.
    scale : ScaleRequest, optional
        What is known of the size of the scene (:mod:`slam_init.scale.requests`): the maps are then in metres.
    restart : bool
        Whether to restart where a map is lost (:mod:`slam_init.mapping.follower`). The result lists all maps.
    imu : bool or InertialSensor
        Whether to use the gyroscope of the source, if it has one (:mod:`slam_init.datasets.inertial`); or the sensor
        of a file (:func:`slam_init.datasets.inertial.read_inertial_file`), whose record is that of the scale too.
    export : collection of str
        Formats of other tools that the maps are written in as well, as of :func:`slam_init.export`. It needs ``out``.

    Returns
    -------
    result : Result
    summary : Summary
        The content of ``summary.json``.

    Raises
    ------
    SlamInitError
        If the method is unknown, a frame cannot be read, or a result cannot be written. The earlier results are then
        unchanged.
    """
    if not callable(getattr(source, "frames", None)):
        raise SourceError(f"the source is of the type {type(source).__name__}: open it by slam_init.open_source(PATH)")
    config = Config() if config is None else config
    check_type(config, Config, "the configuration", "slam_init.Config, or load_config(FILE)", ConfigError)
    at_least = {"start": (start, 0), "max_frames": (max_frames, 1), "continue_frames": (continue_frames, 0)}
    for name, (number, least) in at_least.items():
        if number is None and name != "start":
            continue
        if not isinstance(number, int | np.integer) or number < least:
            raise SlamInitError(f"{name} is {number!r:.40}: give an integer from {least} on")
    if scale is not None:
        check_type(scale, get_args(ScaleRequest), "the scale", "parse_scale(TEXT), as in parse_scale('height:1.65')")
    if not isinstance(imu, bool):
        check_type(imu, InertialSensor, "imu", "True, or read_inertial_file(FILE) (slam_init.datasets.inertial)")
    notes: tuple[str, ...] = ()
    method_info(config.method)  # an unknown method is an error before anything is written
    if is_external(config.method):
        if restart or scale is not None or export:
            raise SlamInitError("restart, scale and export need our own map: leave them out for other programs")
        # Further frames would be read for nothing.
        most = config.external.max_frames
        if max_frames is None or max_frames > most:
            notes = (f"the external program gets at most {most} frames (external.max_frames)",)
        max_frames = min(max_frames or most, most)
    check_formats(export, source)
    camera = camera_of_source(source, camera, start)
    # An external program reports neither tracks nor attempts, and its landmarks are its own.
    own = not is_external(config.method)
    job = Job(
        source, camera, config, start, max_frames, continue_frames, progress, notes, scale, restart, imu, viewer,
        described=own and out is not None, pictured=own and overview,
    )  # fmt: skip
    if out is None:
        done = _finished(job, None)
        return done.result, done.summary
    with OutputFolder(out, "run") as folder:
        try:
            done = _finished(job, folder)
            for prefix, map_, located in maps_of(done.result, done.located):
                stage(folder, prefix, map_, export, source, located)
            toml = config_toml(config)
            publish_results(folder, done.result, done.summary, toml, done.located, done.picture, done.descriptors)
        except SlamInitError:
            raise
        except BaseException as error:  # an interrupt, or an error of the program
            if _keep_recording(folder) and isinstance(error, KeyboardInterrupt):
                raise KeyboardInterrupt(f"interrupted: {folder.path / INTERRUPTED} shows the run so far") from error
            raise
    return done.result, done.summary


def _finished(job: Job, folder: OutputFolder | None) -> Finished:
    """Run a job, and once more with the camera by all its frames, where no window determines the focal length."""
    done = _recorded(job, folder)
    again = calibrated_by_motion(job, done)
    return done if again is None else _recorded(again, folder)


def _recorded(job: Job, folder: OutputFolder | None) -> Finished:
    """Run a job, and draw its overview. The results of a run must not be lost where this fails."""
    if folder is None:
        return _Run(job, Recorder()).finished()
    from slam_init.recording.rerun_recorder import RerunRecorder

    truth, name, seed = job.source.groundtruth, job.source.name, job.config.seed
    seen = reduction_of(job.source, job.camera).camera
    with RerunRecorder(folder.staging / RECORDING, seen, name, truth, seed, job.viewer) as recorder:
        done = _Run(job, recorder).finished()
        recorder.summary(done.summary)
    if not job.pictured:
        return done
    try:
        return replace(done, picture=overview_png(done.result, done.summary, recorder.story, truth))
    except Exception as error:
        warnings.warn(f"{OVERVIEW} was not made: {error}", RuntimeWarning, stacklevel=2)
        return done


def _keep_recording(folder: OutputFolder) -> bool:
    """Put the recording of an interrupted run beside the earlier results; return whether there is one."""
    try:
        (folder.staging / RECORDING).replace(folder.staging / INTERRUPTED)
        folder.keep(INTERRUPTED)
    except (OSError, OutputError):  # it ended before the first frame, or the disk is full
        return False
    return True


#: Memory for images of keyframes: their descriptors need the newest one, and markers need all of them. 256 MB hold 800
#: grey images of 640x480, or 30 of 4K.
_FEW_IMAGE_BYTES, _IMAGE_BYTES = 1 << 25, 1 << 28
#: Number of last frames of which given tracks are kept: a map is lost after five frames at the latest.
_GIVEN_FRAMES = 10
#: Metadata contradict a camera beyond this number of their standard deviations: a right camera is beyond two of them
#: once in twenty, and beyond one in a third of the cases.
_METADATA_SIGMAS = 2.0
_NO_FURTHER_FRAMES = Continuation((), 0, ())


@dataclass(frozen=True, eq=False)
class _Part:
    """What came of the frames until a map was lost, or until the end."""

    result: Result
    first_frame: int
    #: Number of frames that were read.
    frames: int
    #: The frames after the map.
    continued: Continuation = _NO_FURTHER_FRAMES
    descriptors: Descriptors | None = None
    truth: GroundTruthErrors | None = None

    def segment(self) -> Segment:
        """The map and its frames. There is a map."""
        map_, frames = self.result.map, self.result.frames_to_init
        assert map_ is not None
        assert frames is not None
        continued = self.continued
        return Segment(map_, self.first_frame, frames, continued.keyframes, continued.lost_at, self.result.scale)


@dataclass(frozen=True, eq=False)
class Finished:
    """A run that has ended."""

    result: Result
    summary: Summary
    located: tuple[Keyframe, ...]
    descriptors: tuple[Descriptors, ...]
    #: That of the last evaluated window, see :attr:`slam_init.initializer.Initializer.motion`.
    motion: FittedPoses | None
    #: ``overview.png``, if it was asked for.
    picture: bytes | None = None


@dataclass(frozen=True, eq=False)
class Job:
    """The arguments of :func:`run`, checked.

    * ``described``, ``pictured``: Whether the map is described by descriptors, and the run has a picture.
    """

    source: Source
    camera: Camera
    config: Config
    start: int
    max_frames: int | None
    continue_frames: int | None
    progress: bool
    notes: tuple[str, ...]
    scale: ScaleRequest | None
    restart: bool
    imu: bool | InertialSensor
    viewer: str | None
    described: bool
    pictured: bool

    @property
    def record(self) -> InertialRecord | None:
        """What the scale is found from, if it is found from an inertial sensor."""
        if not isinstance(self.scale, MeasuredMotion):
            return None
        return self.imu.record if isinstance(self.imu, InertialSensor) else inertial_of(self.source)

    @property
    def gyroscope(self) -> Gyroscope | None:
        """What measures the rotations between frames, if it is to be used."""
        if not self.imu:
            return None
        return self.imu.gyroscope if isinstance(self.imu, InertialSensor) else gyroscope_of(self.source)

    def available(self, first_frame: int) -> int | None:
        """Number of frames from a frame on; None where nobody knows it."""
        left = getattr(self.source, "left", None)
        length = length_of(self.source)
        return left(first_frame) if left is not None else None if length is None else max(length - first_frame, 0)


class _Run:
    """One pass over the frames of a job."""

    def __init__(self, job: Job, recorder: Recorder) -> None:
        self.job, self.recorder = job, recorder
        self.hashed = InputHash(job.camera)
        if (record := job.record) is not None:
            self.hashed.add(record.timestamps_s, record.rates_rad_s)
            self.hashed.add(record.accelerations_m_s2, record.cam_from_imu.matrix())
        self.memory = FrameMemory(
            _IMAGE_BYTES if isinstance(job.scale, KnownMarkers | KnownBoard) else _FEW_IMAGE_BYTES
        )
        self.reduction = reduction_of(job.source, job.camera)
        self.initializer = make_initializer(job.config.method, self.reduction.camera, job.config, recorder)
        self.tracker: FrameTracker = self.initializer.tracker
        if isinstance(job.source, TrackProvider):
            self.tracker = _GivenTracks(job.source, job.camera, self.hashed)
        # The rules of other systems use no rotations.
        self.turns = StepRotations(job.gyroscope if type(self.initializer) is Initializer else None)
        goes_on = job.restart or job.continue_frames
        frames = job.source.frames(start=job.start, max_frames=None if goes_on else job.max_frames)
        self.frames = self.turns.reading(self.memory.reading(self.reduction.frames(self.hashed.reading(frames))))

    def finished(self) -> Finished:
        """Process the frames, and summarize the run."""
        job, parts = self.job, self._parts()
        result = _whole(parts, job.restart)
        # The notes of a source may change with each frame.
        notes = (*job.notes, *notes_of(job.source), *job.camera.notes, *self.reduction.notes)
        focal_notes = (*_metadata_notes(job.source, job.camera), *_focal_notes(result, job.camera))
        notes = (*notes, *focal_notes, *self.turns.notes, *result.notes)
        if result.map is not None and (note := colmap_note(result.map.camera)):
            notes = (*notes, note)
        result = replace(result, notes=notes)
        descriptors = tuple(part.descriptors for part in parts if part.descriptors is not None)
        located, motion = parts[0].continued.keyframes, self.initializer.motion
        return Finished(result, self._summary(result, parts), located, descriptors, motion)

    def _parts(self) -> list[_Part]:
        """One part, or one for each map."""
        parts, left = [self._part(self.job.start, None)], self.job.continue_frames
        if left is not None:
            left -= parts[0].continued.frames
        while len(parts) < MAX_SEGMENTS and (left is None or left > 0):
            if (lost_at := parts[-1].continued.lost_at) is None:
                break
            self._reset(lost_at)
            parts.append(self._part(lost_at, left))
            if left is not None:
                left -= parts[-1].frames
        return parts

    def _part(self, first_frame: int, left: int | None) -> _Part:
        """Process frames until there is a map and, if asked for, until it is lost; at most ``left`` frames."""
        job, before = self.job, self.initializer.frames_read
        limits = (job.max_frames, None if left is None else before + left)
        most = min((limit for limit in limits if limit), default=None)
        result = replace(self._initialized(job.available(first_frame), most), segments=())
        read = self.initializer.frames_read - before
        if result.map is None:
            return _Part(self.reduction.enlarged(result), first_frame, read)
        images = {k.frame: self.memory[k.frame] for k in result.map.keyframes if k.frame in self.memory}
        descriptors = describe_landmarks(result.map, images) if job.described else None
        count = job.continue_frames if left is None else left - read
        map_, continued = result.map, _NO_FURTHER_FRAMES
        if job.restart or count:
            by_motion = isinstance(job.scale, MeasuredMotion)
            continued = follow(
                map_, self.tracker, self.frames, count, self.recorder, until_lost=job.restart, keep_grown=by_motion
            )
            read += continued.frames
        if continued.ended_by is not None:
            result = replace(result, notes=(*result.notes, f"the continuation ended early: {continued.ended_by}"))
        if job.scale is not None:
            result, continued = self._in_metres(job.scale, map_, result, continued, images)
        result = self.reduction.enlarged(result)
        return _Part(result, first_frame, read, continued, descriptors, self._errors(result, continued))

    def _initialized(self, available: int | None, max_frames: int | None) -> Result:
        """Process frames until there is a map, and until it has grown by the frames that the configuration asks for."""
        from tqdm import tqdm

        # A run hands its map over at once, but for frames that are asked for.
        grows = self.job.config.refine_frames is not None
        total = min((limit for limit in (available, max_frames) if limit is not None), default=None)
        # No time that is left: nobody knows the frame of the map, and the first frames may compile. They report it
        # within the first second, before there is a bar.
        shown = "{l_bar}{bar}| {n_fmt}/{total_fmt} [{elapsed}]"
        with tqdm(total=total, disable=not self.job.progress, leave=False, bar_format=shown, delay=1.0) as bar:
            for frame in self.frames:
                status = self._process(frame)
                bar.set_description(live_text(status), refresh=False)
                bar.update()
                if (status and not (grows and status.refining)) or self.initializer.frames_read == max_frames:
                    break
        return self.initializer.finish()

    def _process(self, frame: Frame) -> Status:
        """Process a frame: its given tracks, or its image with the rotation that a gyroscope measured before it."""
        if isinstance(self.tracker, _GivenTracks):
            observations = self.tracker.track(frame)
            self.recorder.frame(frame, observations)
            return self.initializer.process_tracks(observations)
        if self.turns.latest is None:
            return self.initializer.process(frame)
        rotation, sigma_rad = self.turns.latest
        self.hashed.turned(rotation, sigma_rad)
        return self.initializer.process(frame, rotation=rotation, rotation_sigma_rad=sigma_rad)

    def _reset(self, since: int) -> None:
        """Restart with the tracks from a frame on, which the initializer did not get where they are given."""
        for observed in list(self.tracker.history):
            if observed.frame >= since:
                self.initializer.history.put(observed)
        self.initializer.reset(since)

    def _in_metres(
        self,
        request: ScaleRequest,
        map_: InitialMap,
        result: Result,
        continued: Continuation,
        images: Mapping[int, Image],
    ) -> tuple[Result, Continuation]:
        """Find the scale of a map, and change its unit if there is one."""
        located, grown = continued.keyframes, continued.grown
        truth, record = self.job.source.groundtruth, self.job.record
        scale = find_scale(map_, request, images=images, located=located, groundtruth=truth, imu=record, grown=grown)
        if scale.metres_per_unit is None:
            return replace(result, scale=scale), continued
        map_ = in_metres(map_, scale)
        self.recorder.scaled(scale)
        continued = replace(continued, keyframes=scaled_keyframes(located, scale.metres_per_unit))
        return replace(result, map=map_, hypotheses=(map_,), scale=scale), continued

    def _errors(self, result: Result, continued: Continuation) -> GroundTruthErrors | None:
        """The errors of a map against the ground truth."""
        truth = self.job.source.groundtruth
        if result.map is None or truth is None:
            return None
        errors, scale = compare_with_groundtruth(result.map.keyframes, truth), result.map.scale
        if errors is None or scale is None or scale.origin == ScaleOrigin.GROUNDTRUTH:
            return errors
        return replace(errors, scale_error=scale_error((*result.map.keyframes, *continued.keyframes), truth))

    def _summary(self, result: Result, parts: Sequence[_Part]) -> Summary:
        """Summarize the run, with its errors against the ground truth and its provenance."""
        job = self.job
        continues = parts[0].result.map is not None and (job.restart or job.continue_frames)
        options: dict[str, Json] = {
            "start": job.start, "max_frames": job.max_frames, "continue_frames": job.continue_frames,
            "restart": job.restart, "imu": bool(job.imu),
            "scale": None if job.scale is None else plain_fields(job.scale),
        }  # fmt: skip
        command = [without_password(word) for word in sys.argv]
        estimated = result.map is not None and result.map.camera.source == "estimated"
        return summary_of(
            result,
            SourceRecord(job.source.name, job.source.kind),
            result.map.camera if estimated and result.map is not None else job.camera,
            ground_truth=parts[0].truth,
            continued=parts[0].continued.record() if continues else None,
            segments=tuple(
                SegmentRecord.describe(segment_folder(number), segment, part.continued.record(), part.truth)
                for number, (segment, part) in enumerate(zip(result.segments, parts, strict=False), start=1)
            ),
            provenance=provenance_of(command, plain_fields(job.config) | options, self.hashed.hexdigest()),
        )


def calibrated_by_motion(job: Job, done: Finished) -> Job | None:
    """The same job with the camera by all its frames together, where no window determined the focal length.

    * Returns: None where there is a map or another reason, where the frames do not determine the focal length, or where
      they cannot be read again.
    """
    if done.result.reason != Verdict.UNKNOWN_FOCAL_LENGTH or (length := length_of(job.source)) is None:
        return None
    frames = min(length - job.start, job.max_frames or length)
    if frames > LONGEST_STRETCH or reduction_of(job.source, job.camera).camera is not job.camera:
        found = calibrate(
            job.source, job.camera, job.config, start=job.start, max_frames=job.max_frames, progress=job.progress
        )
    else:
        one = by_all_frames(job.source, job.start, frames, done.motion, job.camera, job.config, bar=job.progress)
        found = combine(job.camera, [] if one is None else [one])
    if found.camera is None:
        return None
    found_px = f"{found.camera.focal_px:.0f} +- {found.camera.focal_sigma_px:.0f} px"
    note = f"the focal length, {found_px}, was found by {frames} frames together; then they were read again"
    return replace(job, camera=found.camera, notes=(*job.notes, note))


def _whole(parts: Sequence[_Part], restart: bool) -> Result:
    """The result of a run: that of its first part, with all maps as segments."""
    first, last = parts[0].result, parts[-1]
    if not restart:
        return first
    notes = [note for part in parts[1:] for note in part.result.notes if note not in first.notes]
    if len(parts) > 1 and last.result.map is None:
        notes.append(f"no further map from frame {last.first_frame} on: {last.result.reason}: {last.result.advice}")
    if last.continued.lost_at is not None:
        notes.append(f"the last map was lost at frame {last.continued.lost_at}, and no further one was looked for")
    segments = tuple(part.segment() for part in parts if part.result.map is not None)
    return replace(first, notes=(*first.notes, *dict.fromkeys(notes)), segments=segments)


class _GivenTracks:
    """Gives the tracks of a source in the place of a tracker, and adds them to the hash of the input."""

    def __init__(self, source: TrackProvider, camera: Camera, hashed: InputHash) -> None:
        self.history = History(camera, _GIVEN_FRAMES)
        self.revised: tuple[Observations, ...] = ()
        self._source = source
        self._camera = camera
        self._hashed = hashed

    def track(self, frame: Frame) -> Observations:
        observations = self._source.observed(frame, self._camera)
        self._hashed.add(observations.track_ids, observations.pixels)
        self.history.put(observations)
        self.history.forget(keep=())
        return observations


def reduction_of(source: Source, camera: Camera) -> Reduction:
    """Choose how the frames are reduced; the tracks of a source that has its own are in original pixels."""
    return Reduction(camera, 1, camera) if isinstance(source, TrackProvider) else Reduction.for_camera(camera)


def _metadata_notes(source: Source, camera: Camera) -> tuple[str, ...]:
    """A note where the files of a source state another focal length than the given camera."""
    if camera.source not in ("stated", "file", "machine"):
        return ()
    stated = camera_of_metadata(source, (camera.width, camera.height))
    if stated is None or abs(stated.focal_px - camera.focal_px) <= _METADATA_SIGMAS * (stated.focal_sigma_px or 0.0):
        return ()
    known = f"{stated.focal_px:.0f} +- {stated.focal_sigma_px:.0f} px"
    return (f"the metadata of the images state a focal length of {known}, the camera {camera.focal_px:.0f} px",)


def _focal_notes(result: Result, stated: Camera) -> tuple[str, ...]:
    """A note on a stated focal length that is no calibration: what the motion made of it, or that nothing did."""
    if result.map is None or (stated.focal_sigma or 0.0) <= CALIBRATED_SIGMA:
        return ()
    known, found = f"{stated.focal_px:.0f} +- {stated.focal_sigma_px:.0f} px", result.map.camera
    if found.source != "estimated":
        method = "is no calibration, and this method does not estimate it: expect a bent map"
        return (f"the focal length, {known}, {method}",)
    if stated.source == "prior":
        return ()
    # A number of a person or of metadata is off by some per cent; the motion corrects it within its deviation.
    return (f"the {stated.source} focal length, {known}, was combined with the motion: {found.focal_px:.0f} px",)


def live_text(status: Status) -> str:
    """What a person who waits wants to know: why there is no map yet, and how far it is."""
    if status:
        return "initialized"
    waits = "reading" if status.reason is None else in_words(status.reason)
    return waits if status.risk is None else f"{waits}, risk {status.risk:.2g}"
