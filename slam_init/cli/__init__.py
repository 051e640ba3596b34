"""The command line: a module for each command, and :mod:`slam_init.cli.main` that runs them."""

from slam_init.cli.main import entry_point, main

__all__ = ["entry_point", "main"]
