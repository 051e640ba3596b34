"""Image-level runs that several tests look at: each is made once a session."""

from __future__ import annotations

import copy
from dataclasses import replace
from itertools import islice

import pytest
from make_source import KeptSource, synth
from runs import Fed, Run

from slam_init.config import Config
from slam_init.initializer import Initializer
from slam_init.runner import run


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
