"""One run from a source to the files of its results."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from slam_init.config import Config, config_toml
from slam_init.continuation import follow
from slam_init.evaluation.metrics import compare_with_groundtruth
from slam_init.methods import make_initializer
from slam_init.methods.registry import method_info
from slam_init.output.results import RECORDING, prepare_folder, summary_dict, write_results
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
    out: Path | None = None,
    start: int = 0,
    max_frames: int | None = None,
    continue_frames: int = 0,
    progress: bool = False,
    notes: tuple[str, ...] = (),
) -> tuple[Result, dict[str, Any]]:
    """Initialize from a source and write what came of it.

    Parameters
    ----------
    source : Source
    camera : Camera
    config : Config
    out : Path, optional
        Folder of the results (see :mod:`slam_init.output.results`) and of the recording; nothing is written without.
    start, max_frames : int
        First frame (absolute index), and how many at most.
    continue_frames : int
        After the initialization, locate this many further frames in the map.
    progress : bool
        Show a progress bar on stderr.
    notes : tuple of str
        What the user should be reminded of, for the summary.

    Returns
    -------
    result : Result
    summary : dict
        The content of ``summary.json``.

    Raises
    ------
    SlamInitError
        Where a frame cannot be read or a result cannot be written.
    """
    method_info(config.method)  # an unknown method is refused before anything is written
    if out is not None:
        prepare_folder(out)
    recorder = (
        Recorder()
        if out is None
        else RerunRecorder(out / RECORDING, camera, source.name, source.groundtruth, config.seed)
    )
    with recorder:
        initializer = make_initializer(config.method, camera, config, recorder)
        frames = source.frames(start=start, max_frames=None if continue_frames else max_frames)
        for frame in _with_progress(frames, min(len(source) - start, max_frames or len(source)), progress):
            if initializer.process(frame) or initializer.frames_read == max_frames:
                break
        result = initializer.finish()
        result = replace(result, notes=(*notes, *result.notes))
        continued = None
        if result.map is not None and continue_frames:
            continued = follow(result.map, initializer.tracker, frames, continue_frames, recorder)
            if continued.ended_by is not None:
                result = replace(result, notes=(*result.notes, f"the continuation ended early: {continued.ended_by}"))
        truth = None
        if result.map is not None and source.groundtruth is not None:
            truth = compare_with_groundtruth(result.map.keyframes, source.groundtruth)
        summary = summary_dict(
            result,
            source,
            camera,
            config.method,
            config.seed,
            truth,
            continued.summary() if continued else None,
        )
        recorder.summary(summary)
    if out is not None:
        poses = continued.keyframes if continued else ()
        write_results(out, result, summary, config_toml(config), poses)
    return result, summary


def _with_progress(frames: Iterator[Frame], total: int, show: bool) -> Iterator[Frame]:
    from tqdm import tqdm

    with tqdm(total=total, unit="frame", desc="waiting for parallax", disable=not show, leave=False) as bar:
        for frame in frames:
            yield frame
            bar.update()
