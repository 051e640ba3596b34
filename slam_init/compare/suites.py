"""Frozen suites: worlds, starts and seeds that never change, so that a figure can be cited by the name of its suite.

World number i has scene i modulo the number of scenes. A hash of the number (SHA-256) chooses the options of a world of
the suite ``simulated``. The hash is the same on all platforms and for all versions of libraries. The checksum of a
suite is that of the tracks of all its worlds (:func:`slam_init.compare.replay.tracks_digest`). Tracks of points depend
on this project and on numpy only. Tracks of images depend on OpenCV's optical flow as well.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from urllib.parse import urlencode


@dataclass(frozen=True)
class Suite:
    """A fixed set of trials. All of them have the seed 0 and end after 150 frames or 5 s of video."""

    name: str
    #: Arguments of :func:`slam_init.compare.sources.open_compared`.
    worlds: tuple[str, ...]
    #: Step between two start frames.
    every: int
    #: Smallest number of frames that a trial can read.
    min_left: int
    #: Checksum of its tracks.
    frozen: str

    def verdict(self, digests: Iterable[str]) -> str:
        """Tell whether the tracks of a run are the frozen ones; ``digests`` are those of the worlds in order."""
        found = hashlib.sha256("".join(digests).encode()).hexdigest()[:16]
        if found == self.frozen:
            return f"suite {self.name}: all {len(self.worlds)} worlds have the frozen tracks (checksum {found})"
        return (
            f"suite {self.name}: the tracks have the checksum {found}, and the frozen ones {self.frozen}: compare "
            "these figures with runs on this machine only"
        )


_SIMULATED_SCENES = (
    "room", "wall", "corridor", "nadir", "desk", "rotation", "rotate-then-move", "tilted-15", "nadir-turn", "static",
    "tilted-30", "tilted-45",
)  # fmt: skip
#: Noise of a coordinate in pixels, share of outliers, baseline over the median depth, relative error of the stated
#: focal length.
_SIMULATED_OPTIONS = {
    "noise_px": (0.3, 0.7, 1.0),
    "outliers": (0.05, 0.15, 0.3),
    "baseline": (0.03, 0.05, 0.1, 0.15, 0.3),
    "focal_error": (0.0, 0.02, 0.05),
}
_RENDERED_SCENES = (
    "room", "wall", "corridor", "rotation", "desk", "nadir-turn", "handheld?speed=0.3", "static", "rotate-then-move",
    "tilted-30", "pan", "handheld-wall?speed=0.3",
)  # fmt: skip


def _simulated(world: int) -> str:
    options = {name: values[_draw(world, name) % len(values)] for name, values in _SIMULATED_OPTIONS.items()}
    return f"points:{_SIMULATED_SCENES[world % len(_SIMULATED_SCENES)]}?{urlencode({**options, 'seed': world})}"


def _rendered(world: int) -> str:
    scene = _RENDERED_SCENES[world % len(_RENDERED_SCENES)]
    return f"synth:{scene}{'&' if '?' in scene else '?'}frames=60&seed={world}"


def _draw(world: int, name: str) -> int:
    # The text names the benchmark that the suites come from.
    digest = hashlib.sha256(f"InitBench 1/0/{world}/{name}".encode()).digest()
    return int.from_bytes(digest[:8], "big")


#: By their names. A world of ``simulated`` has the tracks of 12 frames and one trial: all trials are independent. A
#: world of ``rendered`` has two seconds of video and three trials: nearer starts see mostly the same frames.
SUITES = {
    "simulated": Suite("simulated", tuple(map(_simulated, range(1000))), 10_000, 3, "0f74ff72bb849728"),
    "rendered": Suite("rendered", tuple(map(_rendered, range(24))), 20, 10, "8d7fa4b7e1b85c7e"),
}
