"""Fixtures of image-level runs, which several tests share.

What they need is imported inside them: the tests of quest run where slam_init is not installed.
"""

from __future__ import annotations

import copy
import gc
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import settings

from quest import machine_code

if TYPE_CHECKING:
    from make_source import KeptSource
    from runs import Fed, Run

    from sequences_synth.texture import Texture

# The same examples in each run: a change is evaluated by what it changes. `--hypothesis-profile=default` draws new
# ones. No test checks a time, and a first call may compile. `.ci/run` draws 100, as many as hypothesis does by itself.
settings.register_profile("same", derandomize=True, deadline=None, max_examples=15)
settings.register_profile("more", settings.get_profile("same"), max_examples=100)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))


def pytest_configure() -> None:
    """Workers start with one thread each: further threads of libraries wait for one another, and double the work."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Tell a person who waits that the first tests may compile: what the tests and their workers write is not shown."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    kernels = Path(machine_code.__file__).parent
    window = Path(__file__).parents[1] / "slam_init" / "window"
    sources = [*kernels.glob("*.py"), *window.glob("*.py")]
    kept = [path for folder in machine_code.folders_of(kernels) for path in folder.glob("*.code")]
    newest_source, newest = (max((path.stat().st_mtime for path in some), default=0.0) for some in (sources, kept))
    if reporter is not None and newest < newest_source:
        reporter.write_line("the first tests compile for this machine, once: up to two minutes")


def pytest_collection_finish() -> None:
    """The collector of garbage need not look at thousands of collected tests and at libraries again and again."""
    gc.collect()
    gc.freeze()


@lru_cache(maxsize=64)  # the surfaces of two rooms
def painted(
    paint: Callable[[Texture], list[np.ndarray]], seed: tuple[int, ...], width: int, height: int, look: str
) -> list[np.ndarray]:
    """The levels of a surface."""
    from sequences_synth.texture import Texture

    return paint(Texture(seed, width, height, look))


@pytest.fixture(scope="module", autouse=True)
def surfaces_are_painted_once(request: pytest.FixtureRequest) -> Iterator[None]:
    """Worlds of one seed have the same surfaces, which take longer to paint than a run. Tests of worlds paint each."""
    if {"quest", "sequences_synth"} & {*request.path.parts}:
        yield
        return
    from sequences_synth.texture import Texture

    paint = Texture.__dict__["levels"].func
    with pytest.MonkeyPatch.context() as patch:
        kept = property(lambda one: painted(paint, tuple(one.seed), one.width, one.height, one.look))
        patch.setattr(Texture, "levels", kept)
        yield


@pytest.fixture(scope="session")
def room() -> KeptSource:
    """The default source: a scene in general position."""
    from make_source import synth

    return synth("room")


@pytest.fixture(scope="session")
def room_run(room: KeptSource, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run on the default source that continues for ten frames and writes all files."""
    from runs import Run

    from slam_init import Config, run

    out = tmp_path_factory.mktemp("room") / "out"
    result, summary = run(room, room.camera, Config(), out=out, continue_frames=10)
    return Run(room, result, summary, out)


@pytest.fixture(scope="session")
def room_fed_once(room: KeptSource) -> Fed:
    """An initializer that has processed the default source up to its map."""
    from runs import Fed

    from slam_init import Initializer

    initializer, frames = Initializer(room.camera), room.frames()
    for frame in frames:
        initializer.process(frame)
        if initializer.map is not None:
            break
    return Fed(room, initializer.tracker, initializer.finish(), list(islice(frames, 15)))


@pytest.fixture
def room_fed(room_fed_once: Fed) -> Fed:
    """The same with a separate tracker for each test, since continuing from a map changes the tracker."""
    return replace(room_fed_once, tracker=copy.deepcopy(room_fed_once.tracker))


@pytest.fixture(scope="session")
def room_refined_once(room: KeptSource) -> Fed:
    """A map whose stated focal length was a twentieth too long, and was adjusted."""
    from runs import Fed

    from slam_init import Config, Initializer
    from slam_init.bundle.focal import camera_with_focal_factor

    config = Config()
    config = replace(config, map=replace(config.map, refine_focal=True))
    initializer, frames = Initializer(camera_with_focal_factor(room.camera, 1.05), config), room.frames()
    for frame in frames:
        if initializer.process(frame):
            break
    return Fed(room, initializer.tracker, initializer.finish(), list(islice(frames, 15)))


@pytest.fixture
def room_refined(room_refined_once: Fed) -> Fed:
    """The same with a separate tracker for each test."""
    return replace(room_refined_once, tracker=copy.deepcopy(room_refined_once.tracker))
