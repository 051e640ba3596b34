"""The protocol of a source whose time stamps are known in advance."""

from __future__ import annotations

from typing import Protocol

from slam_init.types.arrays import Floats
from slam_init.types.frame import Source


class TimedSource(Source, Protocol):
    """A source whose length and time stamps are known without decoding its images."""

    @property
    def timestamps_s(self) -> Floats:
        """(N,) float: time stamps of all frames in seconds, strictly increasing."""
        ...

    def __len__(self) -> int:
        """Number of frames. For a video the number in its header; for a bag that in its index, an upper bound."""
        ...
