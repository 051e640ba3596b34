"""The protocol of InitBench: its name, its version, and one run of it."""

from __future__ import annotations

from dataclasses import dataclass

NAME = "InitBench"
#: Raised when a figure of an earlier sheet can no longer be compared: other worlds, other sequences, other judging.
VERSION = 1
SUITES = ("drawn", "rendered", "video")


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


#: A drawn world has 12 frames and one trial, so that all trials are independent. Trials of the other suites start at
#: every 20th frame: nearer starts see mostly the same frames.
DEFAULTS: dict[str, SuiteDefaults] = {
    "drawn": SuiteDefaults(1000, 10_000, 150, 3, "tracks of points in drawn worlds, with exact truth; no download"),
    "rendered": SuiteDefaults(24, 20, 150, 10, "images of rendered worlds, with exact truth; no download"),
    "video": SuiteDefaults(0, 20, 150, 10, "public sequences below SLAM_INIT_DATA"),
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
