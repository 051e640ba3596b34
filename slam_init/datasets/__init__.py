"""Readers: folders, videos and synthetic worlds, all as a :class:`slam_init.types.Source`."""

from slam_init.datasets.opening import TimedSource, detect_kind, open_source

__all__ = ["TimedSource", "detect_kind", "open_source"]
