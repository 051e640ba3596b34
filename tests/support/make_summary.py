"""Summaries of results that were not made by a run."""

from __future__ import annotations

from make_map import CAMERAS

from slam_init.output.records import SourceRecord
from slam_init.output.summary import Summary, summary_of
from slam_init.types.camera import Camera
from slam_init.types.result import Result


def summarize(result: Result, camera: Camera = CAMERAS["pinhole"], **keywords) -> Summary:
    """The summary of a result of the method ``quest``."""
    return summary_of(result, SourceRecord("arc", "images"), camera, **keywords)
