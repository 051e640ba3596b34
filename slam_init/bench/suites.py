"""The worlds of the suites ``drawn`` and ``rendered``.

World number i is the same for any number of worlds, so that a shorter run is a part of a longer one. The options are
chosen by a hash of the world's number (SHA-256), which is the same on all platforms and for all versions of libraries.
"""

from __future__ import annotations

import hashlib
from urllib.parse import urlencode

from slam_init.bench.protocol import NAME, VERSION

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


def _draw(seed: int, world: int, name: str, count: int) -> int:
    text = f"{NAME} {VERSION}/{seed}/{world}/{name}"
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") % count
