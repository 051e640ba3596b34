"""Image-level runs that several tests look at: each is made once a session."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from make_source import KeptSource, synth

from slam_init.config import Config
from slam_init.pipeline import Initializer, run
from slam_init.tracks import Tracker
from slam_init.types import Frame, Result


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


@pytest.fixture(scope="session")
def room() -> KeptSource:
    """A general scene, whole: the embedded default."""
    return synth("room")


@pytest.fixture(scope="session")
def room_run(room: KeptSource, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The main job on the default source, followed by ten frames, with all its files."""
    out = tmp_path_factory.mktemp("room") / "out"
    result, summary = run(room, room.camera, Config(), out=out, continue_frames=10)
    return Run(room, result, summary, out)


@pytest.fixture(scope="session")
def room_fed_once(room: KeptSource) -> Fed:
    """The room, frame by frame until there is a map."""
    initializer, frames = Initializer(room.camera), room.frames()
    for frame in frames:
        initializer.process(frame)
        if initializer.map is not None:
            break
    return Fed(room, initializer.tracker, initializer.finish(), list(islice(frames, 15)))


@pytest.fixture
def room_fed(room_fed_once: Fed) -> Fed:
    """The same, with a tracker of its own for each test: what goes on from a map moves the tracker on."""
    return replace(room_fed_once, tracker=copy.deepcopy(room_fed_once.tracker))
