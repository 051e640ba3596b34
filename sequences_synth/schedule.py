"""Which instants the frames of a sequence show: dropped frames, repeated frames, and a cut to another scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]


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
    def draw(rng: np.random.Generator, frames: int, dropped: float, repeated: float, cut: int) -> Schedule:
        """Draw the frames that are missing and those that repeat the frame before.

        * ``dropped``: Share of the frames that are missing. Neither the first nor the last frame is missing.
        * ``repeated``: Share of the frames that repeat the frame before. The first frame of a scene does not.
        * ``cut``: Position of the first frame of the second scene; 0 for one scene only.
        """
        taken = max(frames, round(frames / (1 - dropped)))
        inner = 1 + rng.permutation(max(taken - 2, 0))[: frames - 2]
        ticks = np.sort(np.concatenate([[0], inner, [taken - 1]]))[-frames:] if frames > 1 else np.zeros(1)
        content = np.arange(frames)
        candidates = np.array([k for k in range(1, frames) if k != cut], np.int64)
        copies = rng.permutation(candidates)[: round(repeated * frames)]
        for k in np.sort(copies):
            content[k] = content[k - 1]
        return Schedule(ticks.astype(np.int64), content.astype(np.int64), cut)

    @property
    def scenes(self) -> tuple[slice, ...]:
        """Frames of each scene."""
        return (slice(0, self.cut), slice(self.cut, len(self.ticks))) if self.cut else (slice(0, len(self.ticks)),)
