"""Which instants the frames of a sequence show: dropped frames, repeated frames, and a cut to another scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Ints
from sequences_synth.options import EffectOptions


@dataclass(frozen=True, eq=False)
class Schedule:
    """The frames of a sequence on the clock of its camera, which takes a frame at each tick."""

    #: (V,) Tick of the time stamp of each frame, ascending from 0. A dropped frame is a tick that no frame has.
    ticks: Ints
    #: (V,) Position of the frame whose image each frame shows: its own, or an earlier one where the frame is
    #: repeated.
    content: Ints
    #: Position of the first frame of the second scene; 0 if there is one scene only.
    cut: int

    @staticmethod
    def draw(rng: np.random.Generator, frames: int, options: EffectOptions) -> Schedule:
        """Draw the frames that are missing and those that repeat the frame before.

        Neither the first nor the last frame is missing, and the first frame of a scene repeats none.
        """
        taken = max(frames, round(frames / (1 - options.dropped)))
        inner = 1 + rng.permutation(max(taken - 2, 0))[: frames - 2]
        ticks = np.sort(np.concatenate([[0], inner, [taken - 1]]))[-frames:] if frames > 1 else np.zeros(1)
        content = np.arange(frames)
        candidates = np.array([k for k in range(1, frames) if k != options.cut], np.int64)
        copies = rng.permutation(candidates)[: round(options.repeated * frames)]
        for k in np.sort(copies):
            content[k] = content[k - 1]
        return Schedule(ticks.astype(np.int64), content.astype(np.int64), options.cut)

    @property
    def scenes(self) -> tuple[slice, ...]:
        """Frames of each scene."""
        return (slice(0, self.cut), slice(self.cut, len(self.ticks))) if self.cut else (slice(0, len(self.ticks)),)

    def shown(self, index: int) -> tuple[int, int]:
        """Find which scene a frame shows, and the tick of its content on the path of this scene."""
        scene = int(0 < self.cut <= range(len(self.ticks))[index])
        return scene, int(self.ticks[self.content[index]] - self.ticks[scene * self.cut])


def stream(seed: int, purpose: bytes, name: str) -> np.random.Generator:
    """Make a generator for one effect. The options of the effect then change neither the scene nor the noise."""
    return np.random.default_rng((seed, *purpose, *name.encode()))
