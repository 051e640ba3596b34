"""One run, from a source to the files of its results."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

from slam_init.config import Config, config_toml
from slam_init.continuation import Continuation, FrameTracker, follow
from slam_init.datasets.live.address import without_password
from slam_init.datasets.track_source import KnowsTracks
from slam_init.errors import OutputError, SlamInitError
from slam_init.evaluation.metrics import compare_with_groundtruth
from slam_init.frontend.tracks import History
from slam_init.mapping.reduction import Reduction
from slam_init.methods import make_initializer
from slam_init.methods.registry import FrontEnd, method_info
from slam_init.output.colmap_cameras import colmap_note
from slam_init.output.folder import OutputFolder
from slam_init.output.names import INTERRUPTED, OVERVIEW, RECORDING, RUN_FILES
from slam_init.output.plain_json import Json, plain_fields
from slam_init.output.provenance import InputHash, provenance_of
from slam_init.output.results import publish_results
from slam_init.output.summary import Summary, summary_of
from slam_init.pictures.overview import overview_png
from slam_init.pictures.story import StoryRecorder
from slam_init.recording.recorder import Recorder, Several
from slam_init.recording.rerun_recorder import RerunRecorder
from slam_init.status import Status
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations, Source, length_of, notes_of
from slam_init.types.pose import Trajectory
from slam_init.types.result import Result

__all__ = ["run"]


def run(
    source: Source,
    camera: Camera,
    config: Config,
    *,
    out: str | os.PathLike[str] | None = None,
    start: int = 0,
    max_frames: int | None = None,
    continue_frames: int = 0,
    progress: bool = False,
    notes: tuple[str, ...] = (),
    overview: bool = True,
    viewer: str | None = None,
) -> tuple[Result, Summary]:
    """Initialize from a source, and write the results.

    Parameters
    ----------
    source : Source
        From :func:`slam_init.open_source`.
    camera : Camera
        The calibration of the frames.
    config : Config
    out : str or path, optional
        Folder of the results and of the recording (see :mod:`slam_init.output.results`): a new or an empty one, or one
        of an earlier run. Without it nothing is written. After an interrupt it holds the earlier results, and the
        recording so far as ``interrupted.rrd``.
    start : int
        Absolute index of the first frame.
    max_frames : int, optional
        Largest number of frames until the initialization.
    continue_frames : int
        Number of frames after the initialization that are located in the map.
    progress : bool
        Show a progress bar on stderr.
    notes : tuple of str
        Notes for the user; the result contains them.
    overview : bool
        Draw ``overview.png``. An interrupted run has none.
    viewer : str, optional
        Address of a Rerun viewer that shows the recording while it is made, as of
        :func:`slam_init.recording.live_viewer.viewer_url`. It needs ``out``.

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
    method_info(config.method)  # an unknown method is an error before anything is written
    job = _Job(source, camera, config, start, max_frames, continue_frames, progress, notes)
    if out is None:
        return job.run(Recorder())[:2]
    with OutputFolder(out, "run", RUN_FILES) as folder:
        recording = folder.staging / RECORDING
        try:
            truth = source.groundtruth
            seen = _reduction(source, camera).camera
            with RerunRecorder(recording, seen, source.name, truth, config.seed, viewer) as recorder:
                story = StoryRecorder(recorder.images) if overview else None
                result, summary, continued = job.run(recorder if story is None else Several(recorder, story))
            keyframes = continued.keyframes if continued else ()
            picture = None if story is None else _drawn(result, summary, story, truth)
            publish_results(folder, result, summary, config_toml(config), keyframes, picture)
        except SlamInitError:
            raise
        except BaseException as error:  # an interrupt, or an error of the program
            if _keep_recording(folder) and isinstance(error, KeyboardInterrupt):
                raise KeyboardInterrupt(f"interrupted: {folder.path / INTERRUPTED} shows the run so far") from error
            raise
    return result, summary


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
        folder.publish([INTERRUPTED])
    except (OSError, OutputError):  # it ended before the first frame, or the disk is full
        return False
    return True


@dataclass(frozen=True, eq=False)
class _Job:
    """The arguments of :func:`run`."""

    source: Source
    camera: Camera
    config: Config
    start: int
    max_frames: int | None
    continue_frames: int
    progress: bool
    notes: tuple[str, ...]

    def run(self, recorder: Recorder) -> tuple[Result, Summary, Continuation | None]:
        """Process the frames, and summarize the run."""
        hashed = InputHash(self.camera)
        reduction = _reduction(self.source, self.camera)
        initializer = make_initializer(self.config.method, reduction.camera, self.config, recorder)
        max_frames = None if self.continue_frames else self.max_frames
        frames = reduction.frames(hashed.reading(self.source.frames(start=self.start, max_frames=max_frames)))
        tracker: FrameTracker = initializer.tracker
        process: Callable[[Frame], Status] = initializer.process
        if isinstance(self.source, KnowsTracks):
            tracker = _GivenTracks(self.source, self.camera, hashed)
            process = partial(_process_tracks, initializer, tracker, recorder)
        result = _initialize(initializer, process, frames, self._available, self.max_frames, self.progress)
        result, continued = _continue(result, tracker, frames, self.continue_frames, recorder)
        # What a source has to tell may change with each frame.
        notes = (*self.notes, *notes_of(self.source), *reduction.notes, *_focal_notes(result, self.camera))
        result = reduction.enlarged(replace(result, notes=(*notes, *result.notes, *_colmap_notes(result))))
        options: dict[str, Json] = {
            "start": self.start, "max_frames": self.max_frames, "continue_frames": self.continue_frames,
        }  # fmt: skip
        summary = _summary(result, self.source, self.camera, self.config, continued, options, hashed)
        recorder.summary(summary)
        return result, summary, continued

    @property
    def _available(self) -> int | None:
        """Number of frames from the start frame on; None where nobody knows it."""
        left = getattr(self.source, "left", None)
        length = length_of(self.source)
        return left(self.start) if left is not None else None if length is None else length - self.start


def _reduction(source: Source, camera: Camera) -> Reduction:
    """How the frames are reduced; the tracks of a source that has its own are in original pixels."""
    return Reduction(camera, 1, camera) if isinstance(source, KnowsTracks) else Reduction.of(camera)


def _focal_notes(result: Result, stated: Camera) -> tuple[str, ...]:
    """A note if the focal length is no calibration, and the method has not estimated it."""
    if result.map is None or stated.focal_sigma is None or result.map.camera.source == "estimated":
        return ()
    return (
        f"the focal length, {stated.focal_px:.0f} +- {stated.focal_sigma_px:.0f} px, is no calibration, and this "
        "method does not estimate it: expect a bent map",
    )


def _colmap_notes(result: Result) -> tuple[str, ...]:
    """What the COLMAP model of the map cannot say about its camera."""
    note = colmap_note(result.map.camera) if result.map is not None else ""
    return (note,) if note else ()


class _GivenTracks:
    """Gives the tracks of a source in the place of a tracker, and adds them to the hash of the input."""

    def __init__(self, source: KnowsTracks, camera: Camera, hashed: InputHash) -> None:
        self.history = History(1)
        self._source = source
        self._camera = camera
        self._hashed = hashed

    def track(self, frame: Frame) -> Observations:
        observations = self._source.observed(frame, self._camera)
        self._hashed.observed(observations)
        return observations


def _process_tracks(initializer: FrontEnd, tracker: FrameTracker, recorder: Recorder, frame: Frame) -> Status:
    """Process a frame of which the tracks are given."""
    observations = tracker.track(frame)
    recorder.frame(frame, observations)
    return initializer.process_tracks(observations)


def _initialize(
    initializer: FrontEnd,
    process: Callable[[Frame], Status],
    frames: Iterator[Frame],
    available: int | None,
    max_frames: int | None,
    progress: bool,
) -> Result:
    """Process frames until there is a map."""
    limits = [limit for limit in (available, max_frames) if limit is not None]
    for frame in _with_progress(frames, min(limits, default=None), progress):
        if process(frame) or initializer.frames_read == max_frames:
            break
    return initializer.finish()


def _with_progress(frames: Iterator[Frame], total: int | None, show: bool) -> Iterator[Frame]:
    """Yield the frames, with a progress bar on stderr."""
    from tqdm import tqdm

    with tqdm(total=total, unit="frame", desc="waiting for parallax", disable=not show, leave=False) as bar:
        for frame in frames:
            yield frame
            bar.update()


def _continue(
    result: Result, tracker: FrameTracker, frames: Iterator[Frame], count: int, recorder: Recorder
) -> tuple[Result, Continuation | None]:
    """Locate further frames in the map, if there is a map and frames are asked for; note an early end."""
    if result.map is None or not count:
        return result, None
    continued = follow(result.map, tracker, frames, count, recorder)
    if continued.ended_by is not None:
        result = replace(result, notes=(*result.notes, f"the continuation ended early: {continued.ended_by}"))
    return result, continued


def _summary(
    result: Result,
    source: Source,
    camera: Camera,
    config: Config,
    continued: Continuation | None,
    options: Mapping[str, Json],
    hashed: InputHash,
) -> Summary:
    """Summarize the run, with its errors against the ground truth and its provenance."""
    truth = None
    if result.map is not None and source.groundtruth is not None:
        truth = compare_with_groundtruth(result.map.keyframes, source.groundtruth)
    estimated = result.map is not None and result.map.camera.source == "estimated"
    command = [without_password(word) for word in sys.argv]
    return summary_of(
        result,
        source,
        result.map.camera if estimated and result.map is not None else camera,
        config.method,
        config.seed,
        ground_truth=truth,
        continued=None if continued is None else continued.record(),
        provenance=provenance_of(command, plain_fields(config) | dict(options), hashed),
    )
