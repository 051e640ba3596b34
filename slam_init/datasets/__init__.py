"""Readers of folders, videos and synthetic sequences; each gives a :class:`slam_init.types.frame.Source`."""

from slam_init.datasets.opening import detect_kind, open_source
from slam_init.types.frame import TimedSource

__all__ = ["TimedSource", "detect_kind", "open_source"]
