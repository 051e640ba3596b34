"""One run, from a source to the files of its results."""

from __future__ import annotations

import os
import warnings
from collections.abc import Collection
from typing import get_args

import numpy as np

from slam_init.calibration.choosing import GivenCamera, camera_of_source
from slam_init.config import Config, config_toml
from slam_init.datasets.inertial import InertialSensor
from slam_init.errors import ConfigError, OutputError, SlamInitError, SourceError, check_type
from slam_init.exports import check_formats, stage
from slam_init.job import Finished, Job, calibrated_by_motion, reduction_of
from slam_init.methods.external_command import is_external
from slam_init.methods.registry import method_info
from slam_init.output.folder import OutputFolder
from slam_init.output.names import INTERRUPTED, OVERVIEW, RECORDING, segment_folder
from slam_init.output.results import publish_results
from slam_init.output.summary import Summary
from slam_init.pictures.overview import overview_png
from slam_init.pictures.story import StoryRecorder
from slam_init.recording.recorder import Recorder, Several
from slam_init.recording.rerun_recorder import RerunRecorder
from slam_init.scale.requests import ScaleRequest
from slam_init.types.frame import Source
from slam_init.types.pose import Trajectory
from slam_init.types.result import Result


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
    notes: tuple[str, ...] = (),
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
    notes : tuple of str
        Notes for the user; the result contains them.
    overview : bool
        Draw ``overview.png``. An interrupted run has none.
    viewer : str, optional
        Address of a Rerun viewer that shows the recording while it is made, as of
        :func:`slam_init.recording.live_viewer.viewer_url`. It needs ``out``.
    scale : ScaleRequest, optional
        What is known of the size of the scene (:mod:`slam_init.scale.requests`): the maps are then in metres.
    restart : bool
        Whether to start anew where a map is lost (:mod:`slam_init.mapping.follower`). The result lists all maps.
    imu : bool or InertialSensor
        Whether to use the gyroscope of the source, if it has one (:mod:`slam_init.datasets.gyroscope`); or the sensor
        of a file (:func:`slam_init.datasets.inertial_file.read_inertial_file`), whose record is that of the scale too.
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
    if not isinstance(notes, tuple | list) or not all(isinstance(note, str) for note in notes):
        raise SlamInitError(f"notes is {notes!r:.40}: give a tuple of texts")
    if scale is not None:
        check_type(scale, get_args(ScaleRequest), "the scale", "parse_scale(TEXT), as in parse_scale('height:1.65')")
    if not isinstance(imu, bool):
        check_type(imu, InertialSensor, "imu", "True, or read_inertial_file(FILE) (slam_init.datasets.inertial_file)")
    method_info(config.method)  # an unknown method is an error before anything is written
    if is_external(config.method):
        if restart or scale is not None or export:
            raise SlamInitError("--restart, --scale and --export need our own map: leave them out for other programs")
        # Further frames would be read for nothing.
        most = config.external.max_frames
        if max_frames is None or max_frames > most:
            notes = (*notes, f"the external program gets at most {most} frames (external.max_frames)")
        max_frames = min(max_frames or most, most)
    check_formats(export, source)
    camera = camera_of_source(source, camera, start)
    # The landmarks of an external program are its own.
    described = out is not None and not is_external(config.method)
    job = Job(
        source,
        camera,
        config,
        start,
        max_frames,
        continue_frames,
        progress,
        notes,
        scale,
        restart,
        described,
        imu,
    )
    if out is None:
        finished = job.run(Recorder())
        if (again := calibrated_by_motion(job, finished)) is not None:
            finished = again.run(Recorder())
        return finished.result, finished.summary
    with OutputFolder(out, "run") as folder:
        try:
            done, picture = _recorded(job, folder, viewer, overview=overview)
            if (again := calibrated_by_motion(job, done)) is not None:
                done, picture = _recorded(again, folder, viewer, overview=overview)
            if export:
                _stage_exports(folder, done, export, source)
            toml = config_toml(config)
            publish_results(folder, done.result, done.summary, toml, done.located, picture, done.descriptors)
        except SlamInitError:
            raise
        except BaseException as error:  # an interrupt, or an error of the program
            if _keep_recording(folder) and isinstance(error, KeyboardInterrupt):
                raise KeyboardInterrupt(f"interrupted: {folder.path / INTERRUPTED} shows the run so far") from error
            raise
    return done.result, done.summary


def _recorded(job: Job, folder: OutputFolder, viewer: str | None, *, overview: bool) -> tuple[Finished, bytes | None]:
    """Run a job with its recording; returns its picture as well, where it is wanted."""
    truth, config = job.source.groundtruth, job.config
    seen = reduction_of(job.source, job.camera).camera
    with RerunRecorder(folder.staging / RECORDING, seen, job.source.name, truth, config.seed, viewer) as recorder:
        # An external program tells neither tracks nor attempts: there is no story to draw.
        drawn = overview and not is_external(config.method)
        story = StoryRecorder(recorder.images) if drawn else None
        done = job.run(recorder if story is None else Several(recorder, story))
        recorder.summary(done.summary)
    return done, None if story is None else _drawn(done.result, done.summary, story, truth)


def _stage_exports(folder: OutputFolder, done: Finished, export: Collection[str], source: Source) -> None:
    """Write each map in the formats of other tools, beside its own files."""
    for number, segment in enumerate(done.result.segments, start=1):
        stage(folder, f"{segment_folder(number)}/", segment.map, export, source, segment.located)
    if not done.result.segments and done.result.map is not None:
        stage(folder, "", done.result.map, export, source, done.located)


def _drawn(result: Result, summary: Summary, story: StoryRecorder, truth: Trajectory | None) -> bytes | None:
    """Draw the overview; None with a warning where this fails, since the results of a run must not be lost by it."""
    try:
        return overview_png(result, summary, story.story(), truth)
    except Exception as error:
        warnings.warn(f"{OVERVIEW} was not drawn: {error}", RuntimeWarning, stacklevel=2)
        return None


def _keep_recording(folder: OutputFolder) -> bool:
    """Put the recording of an interrupted run beside the earlier results; return whether there is one."""
    try:
        (folder.staging / RECORDING).replace(folder.staging / INTERRUPTED)
        folder.keep(INTERRUPTED)
    except (OSError, OutputError):  # it ended before the first frame, or the disk is full
        return False
    return True
