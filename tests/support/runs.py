"""The types of the fixtures in ``conftest.py``."""

from dataclasses import dataclass
from pathlib import Path

from make_source import KeptSource

from slam_init.frontend.tracks import Tracker
from slam_init.output.summary import Summary
from slam_init.types.frame import Frame
from slam_init.types.result import Result


@dataclass(frozen=True)
class Run:
    """A run with its results."""

    source: KeptSource
    result: Result
    summary: Summary
    out: Path


@dataclass(frozen=True)
class Fed:
    """The state of an initializer once it has a map, and the frames that follow."""

    source: KeptSource
    tracker: Tracker
    result: Result
    following: list[Frame]
