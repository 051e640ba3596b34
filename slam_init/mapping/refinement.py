"""What becomes of an accepted map while its initializer gets further frames: it grows until it is final.

``Config.refine_frames`` says for how many frames. By default these are as many as it takes until the median deviation
of its depths, with the errors that tracks share, is at most ``acceptance.max_depth_sigma``. The gate of the acceptance
knows the noise of single tracks only. A map that is lost is final as it was before the loss.
"""

from __future__ import annotations

from collections.abc import Sequence

from slam_init.config import Config
from slam_init.mapping.growing import GrowingMap, Located
from slam_init.types.frame import Observations
from slam_init.types.initial_map import InitialMap


class Refinement:
    """An accepted map that grows.

    * ``map``: The accepted map until :attr:`done`, and the grown one from then on.
    * ``done``: Whether it is final.
    * ``frames``: Number of frames since the acceptance.
    """

    def __init__(self, map_: InitialMap, config: Config) -> None:
        self.map, self.frames = map_, 0
        self._config = config
        self._growing: GrowingMap | None = None
        self._evaluated = 0
        most, target = config.refine_frames, config.acceptance.max_depth_sigma
        self.done = most == 0 or (most is None and map_.depth_sigma <= target)

    @property
    def lost_at(self) -> int | None:
        """Absolute index of the first frame in which the map was lost; None while it is not."""
        return None if self._growing is None else self._growing.lost_at

    def locate(self, observed: Observations, revised: Sequence[Observations] = ()) -> Located | None:
        """Locate the next frame, and hand the map over if it is time to; see :meth:`.growing.GrowingMap.locate`."""
        if self._growing is None:
            self._growing = GrowingMap(self.map, self._config.map)
        self.frames += 1
        located = self._growing.locate(observed, revised)
        if self._growing.lost_at is not None or self._enough(self._growing):
            self.end()
        return located

    def end(self) -> None:
        """Hand the map over as it is now."""
        if self._growing is not None and not self.done:
            self.map = self._growing.grown()
        self.done = True

    def _enough(self, growing: GrowingMap) -> bool:
        """Whether the number of frames or the deviation of the depths is reached; keyframes alone change the latter."""
        if self._config.refine_frames is not None:
            return self.frames >= self._config.refine_frames
        if growing.keyframes_added == self._evaluated:
            return False
        self._evaluated = growing.keyframes_added
        return growing.grown().depth_sigma <= self._config.acceptance.max_depth_sigma
