"""``python -m slam_init``."""

from slam_init.cli import entry_point

entry_point()
