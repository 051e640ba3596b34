"""A source that knows its time stamps."""

from __future__ import annotations

from typing import Protocol

from slam_init.types.arrays import Floats
from slam_init.types.frame import Source

__all__ = ["TimedSource"]


class TimedSource(Source, Protocol):
    """A source that knows its time stamps without reading its images."""

    @property
    def timestamps_s(self) -> Floats:
        """(N,) float, strictly increasing."""
        ...
