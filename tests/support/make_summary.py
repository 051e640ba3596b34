"""Summaries of results that were not made by a run."""

from __future__ import annotations

from pathlib import Path

from make_map import CAMERAS

from slam_init.output.folder import OutputFolder
from slam_init.output.results import publish_results
from slam_init.output.summary import SourceRecord, Summary, summary_of
from slam_init.types.camera import Camera
from slam_init.types.result import Result


def summarize(result: Result, camera: Camera = CAMERAS["pinhole"], **keywords) -> Summary:
    """The summary of a result of the method ``quest``."""
    return summary_of(result, SourceRecord("arc", "images"), camera, **keywords)


def write_results(out: Path, result: Result, summary: Summary, *others, **keywords) -> None:
    """Write a folder of results without a run."""
    with OutputFolder(out, "run") as folder:
        publish_results(folder, result, summary, *others, **keywords)
