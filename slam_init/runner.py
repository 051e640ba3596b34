"""One run, from a source to the files of its results."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from slam_init.config import Config, config_toml
from slam_init.continuation import Continuation, follow
from slam_init.evaluation.metrics import compare_with_groundtruth
from slam_init.methods import make_initializer
from slam_init.methods.registry import FrontEnd, method_info
from slam_init.output.plain_json import Json, plain_fields
from slam_init.output.provenance import InputHash, provenance_of
from slam_init.output.results import RECORDING, prepare_folder, write_results
from slam_init.output.summary import Summary, summary_of
from slam_init.recording.recorder import Recorder
from slam_init.recording.rerun_recorder import RerunRecorder
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Source, notes_of
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
        Folder of the results (see :mod:`slam_init.output.results`) and of the recording. Without it nothing is written.
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

    Returns
    -------
    result : Result
    summary : Summary
        The content of ``summary.json``.

    Raises
    ------
    SlamInitError
        If the method is unknown, a frame cannot be read, or a result cannot be written.
    """
    method_info(config.method)  # an unknown method is an error before anything is written
    folder = None if out is None else Path(out)
    hashed = InputHash(camera)
    with _recorder(folder, camera, source, config) as recorder:
        initializer = make_initializer(config.method, camera, config, recorder)
        frames = hashed.reading(source.frames(start=start, max_frames=None if continue_frames else max_frames))
        result = _initialize(initializer, frames, len(source) - start, max_frames, progress)
        result = replace(result, notes=(*notes, *notes_of(source), *result.notes))
        result, continued = _continue(result, initializer, frames, continue_frames, recorder)
        options = {"start": start, "max_frames": max_frames, "continue_frames": continue_frames}
        summary = _summary(result, source, camera, config, continued, options, hashed)
        recorder.summary(summary)
    if folder is not None:
        write_results(folder, result, summary, config_toml(config), continued.keyframes if continued else ())
    return result, summary


def _recorder(folder: Path | None, camera: Camera, source: Source, config: Config) -> Recorder:
    """Prepare the folder and return a recorder that writes to it; without a folder, one that does nothing."""
    if folder is None:
        return Recorder()
    prepare_folder(folder)
    return RerunRecorder(folder / RECORDING, camera, source.name, source.groundtruth, config.seed)


def _initialize(
    initializer: FrontEnd, frames: Iterator[Frame], available: int, max_frames: int | None, progress: bool
) -> Result:
    """Process frames until there is a map."""
    for frame in _with_progress(frames, min(available, max_frames or available), progress):
        if initializer.process(frame) or initializer.frames_read == max_frames:
            break
    return initializer.finish()


def _with_progress(frames: Iterator[Frame], total: int, show: bool) -> Iterator[Frame]:
    """Yield the frames, with a progress bar on stderr."""
    from tqdm import tqdm

    with tqdm(total=total, unit="frame", desc="waiting for parallax", disable=not show, leave=False) as bar:
        for frame in frames:
            yield frame
            bar.update()


def _continue(
    result: Result, initializer: FrontEnd, frames: Iterator[Frame], count: int, recorder: Recorder
) -> tuple[Result, Continuation | None]:
    """Locate further frames in the map, if there is a map and frames are asked for; note an early end."""
    if result.map is None or not count:
        return result, None
    continued = follow(result.map, initializer.tracker, frames, count, recorder)
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
    return summary_of(
        result,
        source,
        camera,
        config.method,
        config.seed,
        ground_truth=truth,
        continued=None if continued is None else continued.record(),
        provenance=provenance_of(sys.argv, plain_fields(config) | dict(options), hashed),
    )
