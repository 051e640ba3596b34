"""Planes at short baselines with depths from elsewhere: ``python -m tests.benchmarks.depth``.

The worlds are those of the part slow-planes of :mod:`tests.benchmarks.study`. The depths of the tracks are

* right: the true ones with a smooth error of 10 % (root mean square) that all views share, and in each view another
  scale and, for inverse depths, another shift,
* or wrong: of a plane whose normal is off by 30 degrees about an axis of chance, or of another scene.

Outliers and tracks on moving bodies have the depth of the nearest track of the scene.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.compare.judging import Criteria
from slam_init.compare.measures import is_correct, pose_errors
from slam_init.compare.sources import open_compared
from slam_init.datasets.points import PointSource
from slam_init.initializer import Initializer
from slam_init.types.arrays import Floats
from slam_init.types.depth import Depth, DepthKind
from slam_init.types.frame import Observations
from tests.benchmarks.options import positive
from tests.benchmarks.study_parts import PARTS

#: Relative error of the depths.
_ERROR = 0.1
_TILT_DEG = 30.0


class World(NamedTuple):
    """A world of tracks, and what the depths of one trial draw once."""

    source: PointSource
    #: Phases (M, 3) and frequencies (M, 2) of the smooth error over the image.
    waves: Floats
    #: (3,) Rotation vector of the wrong normal.
    tilt: Floats
    other: PointSource

    @staticmethod
    def drawn(text: str, number: int) -> World:
        """Open a world."""
        rng = np.random.default_rng(number)
        another = ("room", "corridor", "desk")[number % 3]
        source, other = _points(text), _points(f"points:{another}?seed={90000 + number}")
        axis = rng.normal(size=3)
        axis[2] = 0.0
        waves = np.column_stack([rng.uniform(0, 2 * np.pi, 6), rng.uniform(-1.0, 1.0, (6, 2))])
        return World(source, waves, np.deg2rad(_TILT_DEG) * axis / np.linalg.norm(axis), other)

    def inverse_depths(self, observed: Observations) -> Floats:
        """The true inverse depths of tracks, those of outliers by their nearest neighbours."""
        return _at(self.source, observed.frame, observed.pixels)

    def error(self, observed: Observations) -> Floats:
        """The smooth relative error, the same function of the pixel in all views."""
        camera = self.source.camera
        places = 2 * np.pi * observed.pixels / camera.width
        waves = np.cos(places @ self.waves[:, 1:].T + self.waves[:, 0])
        return np.asarray(_ERROR * np.sqrt(2 / len(self.waves)) * waves.sum(axis=1))

    def view(self, observed: Observations, *, shifted: bool) -> tuple[float, float]:
        """The scale and the shift of a view."""
        rng = np.random.default_rng((self.source.sequence.seed, observed.frame))
        return float(np.exp(rng.normal(0.0, 0.5))), float(rng.normal(0.0, 0.3)) if shifted else 0.0


def _points(text: str) -> PointSource:
    source = open_compared(text)
    assert isinstance(source, PointSource)
    return source


def _at(source: PointSource, frame: int, pixels: Floats) -> Floats:
    ids, at = source.sequence.observe(frame)
    inverse = 1 / source.sequence.depths(frame)[ids]
    known = np.isfinite(inverse)
    nearest = np.argmin(((pixels[:, None] - at[known]) ** 2).sum(axis=2), axis=1)
    return np.asarray(inverse[known][nearest])


def _right(world: World, observed: Observations) -> Floats:
    return world.inverse_depths(observed) * (1 + world.error(observed))


def _exact(world: World, observed: Observations) -> Floats:
    return world.inverse_depths(observed)


def _tilted(world: World, observed: Observations) -> Floats:
    """Inverse depths of the plane next to the scene, with another normal."""
    inverse = world.inverse_depths(observed)
    rays = observed.bearings / observed.bearings[:, 2:]
    plane = np.linalg.lstsq(rays, inverse, rcond=None)[0]
    wrong = rays @ (rotation_from_vector(world.tilt) @ plane) / (rays @ plane)
    return inverse * np.maximum(wrong, 0.05)


def _other_scene(world: World, observed: Observations) -> Floats:
    return _at(world.other, observed.frame % len(world.other), observed.pixels)


_TRUTHS: dict[str, Callable[[World, Observations], Floats]] = {
    "right": _right,
    "exact": _exact,
    "tilted": _tilted,
    "other": _other_scene,
}
#: Rows of the table: what the depths are, and their kind; None without depths.
ROWS: dict[str, tuple[str, DepthKind] | None] = {
    "no depth": None,
    "right, scale": ("right", DepthKind.SCALE),
    "right, inverse": ("right", DepthKind.INVERSE),
    "scale x 3, no error": ("exact", DepthKind.METRIC),
    "normal off by 30 degrees, scale": ("tilted", DepthKind.SCALE),
    "normal off by 30 degrees, inverse": ("tilted", DepthKind.INVERSE),
    "another scene, scale": ("other", DepthKind.SCALE),
    "another scene, inverse": ("other", DepthKind.INVERSE),
}


def depth_of(row: str, world: World, observed: Observations) -> Depth | None:
    """The depths of the tracks of a frame for a row of the table."""
    chosen = ROWS[row]
    if chosen is None:
        return None
    truth, kind = chosen
    inverse = _TRUTHS[truth](world, observed)
    scale, shift = world.view(observed, shifted=kind == DepthKind.INVERSE)
    if kind == DepthKind.INVERSE:
        return Depth(scale * (inverse + shift * float(np.median(inverse))), kind, _ERROR)
    return Depth(3 / inverse if kind == DepthKind.METRIC else scale / inverse, kind, _ERROR)


def run_world(text: str, row: str, number: int) -> tuple[str, int]:
    """Run one world: its outcome or the reason without a map, and the frames it took."""
    world = World.drawn(text, number)
    initializer = Initializer(world.source.camera)
    for observed in world.source.observations():
        if initializer.process_tracks(observed, depth=depth_of(row, world, observed)):
            break
    result = initializer.finish()
    if result.map is None:
        return str(result.reason), len(world.source)
    correct = is_correct(pose_errors(result.map, world.source.groundtruth), Criteria())
    return "correct" if correct else "false", initializer.frames_read


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.depth", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--worlds", type=positive, default=160, metavar="N", help="worlds at each baseline (160)")
    parser.add_argument("--baseline", type=int, default=0, choices=(0, 1, 2), help="of the part slow-planes (0: .03)")
    parser.add_argument("--row", action="append", choices=tuple(ROWS), help="may be repeated; default: all")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    arguments = parser.parse_args(argv)
    texts = PARTS["slow-planes"].cells(arguments.worlds, arguments.seed)[arguments.baseline].sources
    sys.stdout.write("| depth | correct/false/none | frames (mean) | reasons without a map |\n|---|--:|--:|---|\n")
    for row in arguments.row or ROWS:
        found = [run_world(text, row, number) for number, text in enumerate(texts)]
        outcomes = Counter(outcome for outcome, _ in found)
        correct, false = outcomes.pop("correct", 0), outcomes.pop("false", 0)
        frames = np.mean([frames for _, frames in found])
        reasons = ", ".join(f"{name} {count}" for name, count in outcomes.most_common())
        none = outcomes.total()
        sys.stdout.write(f"| {row} | {correct}/{false}/{none} | {frames:.2f} | {reasons} |\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
