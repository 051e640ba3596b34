"""What the session's fixtures hold."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from make_source import KeptSource

from slam_init.frontend.tracks import Tracker
from slam_init.types.frame import Frame
from slam_init.types.result import Result


@dataclass(frozen=True)
class Run:
    """A run and what it left."""

    source: KeptSource
    result: Result
    summary: dict[str, Any]
    out: Path


@dataclass(frozen=True)
class Fed:
    """What an initializer holds once it has a map, and the frames that follow."""

    source: KeptSource
    tracker: Tracker
    result: Result
    following: list[Frame]
