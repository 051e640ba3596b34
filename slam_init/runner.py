"""One run, from a source to the files of its results."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from slam_init.config import Config, config_toml
from slam_init.continuation import Continuation, follow
from slam_init.evaluation.metrics import compare_with_groundtruth
from slam_init.methods import make_initializer
from slam_init.methods.registry import FrontEnd, method_info
from slam_init.output.provenance import InputHash, provenance_of
from slam_init.output.results import RECORDING, prepare_folder, write_results
from slam_init.output.summary import Provenance, Summary, plain_fields, summary_of
from slam_init.recording.recorder import Recorder, RerunRecorder
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Source
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
        Of :func:`slam_init.open_source`.
    camera : Camera
        The calibration of the frames.
    config : Config
        All options.
    out : str or path, optional
        Folder of the results (see :mod:`slam_init.output.results`) and of the recording. Without it nothing is written.
    start, max_frames : int
        First frame (absolute index), and largest number of frames.
    continue_frames : int
        After the initialization, locate this many further frames in the map.
    progress : bool
        Show a progress bar on stderr.
    notes : tuple of str
        Notes for the user, which the result repeats.

    Returns
    -------
    result : Result
    summary : Summary
        The content of ``summary.json``.

    Raises
    ------
    SlamInitError
        Where the method is unknown, a frame cannot be read, or a result cannot be written.
    """
    method_info(config.method)  # an unknown method is refused before anything is written
    folder = None if out is None else Path(out)
    hashed = InputHash(camera)
    with _recorder(folder, camera, source, config) as recorder:
        initializer = make_initializer(config.method, camera, config, recorder)
        frames = hashed.reading(source.frames(start=start, max_frames=None if continue_frames else max_frames))
        result = _initialize(initializer, frames, len(source) - start, max_frames, progress)
        result = replace(result, notes=(*notes, *result.notes))
        continued = None
        if result.map is not None and continue_frames:
            continued = follow(result.map, initializer.tracker, frames, continue_frames, recorder)
            result = _with_early_end(result, continued)
        options = {"start": start, "max_frames": max_frames, "continue_frames": continue_frames}
        provenance = provenance_of(sys.argv, plain_fields(config) | options, hashed)
        summary = _summary(result, source, camera, config, continued, provenance)
        recorder.summary(summary)
    if folder is not None:
        write_results(folder, result, summary, config_toml(config), continued.keyframes if continued else ())
    return result, summary


def _recorder(folder: Path | None, camera: Camera, source: Source, config: Config) -> Recorder:
    """A recorder that writes to the folder, which is prepared; one that does nothing without a folder."""
    if folder is None:
        return Recorder()
    prepare_folder(folder)
    return RerunRecorder(folder / RECORDING, camera, source.name, source.groundtruth, config.seed)


def _initialize(
    initializer: FrontEnd, frames: Iterator[Frame], available: int, max_frames: int | None, progress: bool
) -> Result:
    """Feed frames until there is a map."""
    for frame in _with_progress(frames, min(available, max_frames or available), progress):
        if initializer.process(frame) or initializer.frames_read == max_frames:
            break
    return initializer.finish()


def _with_progress(frames: Iterator[Frame], total: int, show: bool) -> Iterator[Frame]:
    from tqdm import tqdm

    with tqdm(total=total, unit="frame", desc="waiting for parallax", disable=not show, leave=False) as bar:
        for frame in frames:
            yield frame
            bar.update()


def _with_early_end(result: Result, continued: Continuation) -> Result:
    if continued.ended_by is None:
        return result
    return replace(result, notes=(*result.notes, f"the continuation ended early: {continued.ended_by}"))


def _summary(
    result: Result,
    source: Source,
    camera: Camera,
    config: Config,
    continued: Continuation | None,
    provenance: Provenance,
) -> Summary:
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
        provenance=provenance,
    )
