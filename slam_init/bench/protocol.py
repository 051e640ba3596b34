"""The protocol of InitBench: its name and version, one run of it, its worlds, and the digests of its tracks.

World number i of a suite is the same for any number of worlds, so that a shorter run is a part of a longer one. The
options are chosen by a hash of the world's number (SHA-256), which is the same on all platforms and for all versions of
libraries. ``frozen.json`` holds, for each suite, the digest of the tracks of each source
(:func:`slam_init.compare.replay.tracks_digest`), and the libraries that they were made with. Tracks of points depend on
this project and on numpy only. Tracks of images depend on OpenCV's optical flow as well.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from urllib.parse import urlencode

NAME = "InitBench"
#: Raised when a figure of an earlier sheet can no longer be compared: other worlds, other sequences, other judging.
VERSION = 1
SUITES = ("drawn", "rendered", "video", "other")


@dataclass(frozen=True)
class SuiteDefaults:
    """The fixed numbers of a suite."""

    #: Number of worlds; 0 for sequences of a manifest.
    worlds: int
    #: Step between two start frames of a sequence.
    every: int
    #: A trial ends after this number of frames, or after 5 s of video.
    limit_frames: int
    #: Smallest number of frames that a trial can read.
    min_left: int
    #: One line.
    about: str


#: A drawn world has 12 frames and one trial, so that all trials are independent; a world of another generator has one
#: trial as well. Trials of sequences start at every 20th frame: nearer starts see mostly the same frames.
DEFAULTS: dict[str, SuiteDefaults] = {
    "drawn": SuiteDefaults(1000, 10_000, 150, 3, "tracks of points in drawn worlds, with exact truth; no download"),
    "rendered": SuiteDefaults(24, 20, 150, 10, "images of rendered worlds, with exact truth; no download"),
    "video": SuiteDefaults(0, 20, 150, 10, "public sequences below SLAM_INIT_DATA"),
    "other": SuiteDefaults(60, 10_000, 150, 3, "tracks of worlds that another generator draws: give --generator DIR"),
}


@dataclass(frozen=True)
class Run:
    """One run of the benchmark, as its command line tells."""

    suite: str
    #: Number of worlds; 0 for ``video``.
    worlds: int
    #: Seed of the worlds and of the random draws of the methods.
    seed: int
    #: Step between two start frames.
    every: int
    #: The chosen sequences of ``video``; empty for all at hand.
    sequences: tuple[str, ...]
    methods: tuple[str, ...]
    #: Name of the folder of the generator of ``other``: the sheet does not depend on where the folder lies.
    generator: str = ""

    def departures(self) -> list[str]:
        """Tell in which options a run departs from the protocol."""
        default = DEFAULTS[self.suite]
        departures = []
        if self.worlds != default.worlds:
            departures.append(f"{self.worlds} worlds in place of {default.worlds}")
        if self.seed != 0:
            departures.append(f"seed {self.seed} in place of 0")
        if self.every != default.every:
            departures.append(f"a start at every {self.every} frames in place of {default.every}")
        if self.sequences:
            departures.append("chosen sequences")
        return departures

    def words(self, methods: tuple[str, ...] | None = None) -> list[str]:
        """Return the command line of this run."""
        default = DEFAULTS[self.suite]
        words = ["slam-init", "bench", "--suite", self.suite]
        for option, value, usual in (
            ("--worlds", self.worlds, default.worlds),
            ("--seed", self.seed, 0),
            ("--every", self.every, default.every),
        ):
            if value != usual:
                words += [option, str(value)]
        if self.generator:
            words += ["--generator", self.generator]
        if self.sequences:
            words += ["--sequences", ",".join(self.sequences)]
        chosen = self.methods if methods is None else methods
        named = [method for method in chosen if "," not in method and "command:" not in method]
        if named:
            words += ["--methods", ",".join(named)]
        for method in chosen:
            if method not in named:
                words += ["--method", method]
        return words


#: Scenes of ``drawn``. World i has scene i modulo their number.
DRAWN_SCENES = (
    "room", "wall", "corridor", "nadir", "desk", "rotation", "rotate-then-move", "tilted-15", "nadir-turn", "static",
    "tilted-30", "tilted-45",
)  # fmt: skip
#: Noise of a coordinate in pixels, share of outliers, baseline over the median depth, relative error of the stated
#: focal length.
DRAWN_OPTIONS: dict[str, tuple[float, ...]] = {
    "noise_px": (0.3, 0.7, 1.0),
    "outliers": (0.05, 0.15, 0.3),
    "baseline": (0.03, 0.05, 0.1, 0.15, 0.3),
    "focal_error": (0.0, 0.02, 0.05),
}
#: Scenes of ``rendered``; world i has scene i modulo their number.
RENDERED_SCENES = (
    "room", "wall", "corridor", "rotation", "desk", "nadir-turn", "handheld?speed=0.3", "static", "rotate-then-move",
    "tilted-30", "pan", "handheld-wall?speed=0.3",
)  # fmt: skip
#: Two seconds of video: a start at every 20th frame gives three trials.
_FRAMES = 60
#: Seeds of the worlds of two seeds of the benchmark never meet.
_SEEDS = 1_000_000
_FIRST_OTHER = 10_000


def simulated_worlds(count: int, seed: int) -> list[str]:
    """List the worlds of the suite ``drawn``.

    * Returns: Arguments of :func:`slam_init.compare.sources.open_compared`.
    """
    worlds = []
    for i in range(count):
        options = {name: values[_draw(seed, i, name, len(values))] for name, values in DRAWN_OPTIONS.items()}
        scene = DRAWN_SCENES[i % len(DRAWN_SCENES)]
        worlds.append(f"points:{scene}?{urlencode({**options, 'seed': _SEEDS * seed + i})}")
    return worlds


def rendered_worlds(count: int, seed: int) -> list[str]:
    """List the worlds of the suite ``rendered``.

    * Returns: Arguments of :func:`slam_init.compare.sources.open_compared`.
    """
    worlds = []
    for i in range(count):
        scene = RENDERED_SCENES[i % len(RENDERED_SCENES)]
        worlds.append(f"synth:{scene}{'&' if '?' in scene else '?'}frames={_FRAMES}&seed={_SEEDS * seed + i}")
    return worlds


def other_seeds(count: int, seed: int) -> range:
    """List the seeds of the worlds of the suite ``other``. Smaller seeds are free for the choice of numbers."""
    first = _FIRST_OTHER + _SEEDS * seed
    return range(first, first + count)


def _draw(seed: int, world: int, name: str, count: int) -> int:
    text = f"{NAME} {VERSION}/{seed}/{world}/{name}"
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") % count


@dataclass(frozen=True)
class FrozenCheck:
    """The digests of a run compared with the frozen ones."""

    #: Number of sources of the run.
    sources: int
    #: Number of sources with the frozen digest.
    same: int
    #: Sources with another digest than the frozen one.
    different: tuple[str, ...]
    #: Number of sources without a frozen digest.
    unknown: int
    #: The libraries that the frozen digests were made with.
    made_with: str

    @property
    def text(self) -> str:
        """Return the result in one sentence."""
        if self.different:
            return (
                f"{len(self.different)} of {self.sources} sources have other tracks than the frozen ones (made with "
                f"{self.made_with}): compare these figures with runs on this machine only"
            )
        if self.same == self.sources:
            return f"all {self.sources} sources have the frozen tracks"
        return f"{self.same} of {self.sources} sources have the frozen tracks; {self.unknown} are not frozen"


@dataclass(frozen=True)
class _Frozen:
    """The content of ``frozen.json`` for this version: digest by source, libraries by suite, checksum by sequence."""

    digests: Mapping[str, Mapping[str, str]]
    made_with: Mapping[str, Mapping[str, str]]
    checksums: Mapping[str, str]


@cache
def _frozen() -> _Frozen:
    text = files("slam_init.bench").joinpath("frozen.json").read_text(encoding="utf-8")
    content = json.loads(text)[str(VERSION)]
    # The worlds of ``drawn`` are listed by their number.
    drawn = dict(zip(simulated_worlds(len(content["drawn"]), 0), content["drawn"], strict=True))
    digests = {"drawn": drawn, **{suite: content[suite] for suite in SUITES[1:]}}
    return _Frozen(digests, content["made_with"], content["checksums"])


def check_frozen(suite: str, digests: Mapping[str, str]) -> FrozenCheck:
    """Compare digests with the frozen ones.

    * ``digests``: By the label of the source. A sequence is known by the name of its folder, a world of another
      generator by its seed.
    """
    frozen = _frozen()
    known = frozen.digests[suite]
    expected = {label: known.get(frozen_key(suite, label)) for label in digests}
    different = tuple(label for label, digest in digests.items() if expected[label] not in (None, digest))
    unknown = sum(digest is None for digest in expected.values())
    made_with = ", ".join(f"{name} {number}" for name, number in frozen.made_with.get(suite, {}).items())
    return FrozenCheck(len(digests), len(digests) - len(different) - unknown, different, unknown, made_with)


def frozen_checksum(sequence: str) -> str | None:
    """Return the checksum of the files of a public sequence.

    * Returns: None if the sequence was not at hand when this version was frozen.
    """
    return _frozen().checksums.get(sequence)


def frozen_key(suite: str, label: str) -> str:
    """Return the name by which the digest of a source is frozen."""
    if suite == "other":
        return label.partition("?")[0]
    return Path(label).name if suite == "video" else label
