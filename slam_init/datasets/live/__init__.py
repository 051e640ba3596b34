"""Live sources: a camera of this machine, a network stream, and a video on the standard input.

:mod:`~slam_init.datasets.live.address` reads the names, :mod:`~slam_init.datasets.live.streams` receives images, and
:mod:`~slam_init.datasets.live.source` makes a source of them.
"""

from slam_init.datasets.live.address import is_live, open_live
from slam_init.datasets.live.source import LiveSource

__all__ = ["LiveSource", "is_live", "open_live"]
