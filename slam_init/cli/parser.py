"""The parser of the commands, and what several commands check."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, NoReturn, TypeAlias

from slam_init.errors import SlamInitError
from slam_init.process_io import tell

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

    Commands: TypeAlias = "argparse._SubParsersAction[Parser]"

__all__ = ["OUT_HELP", "Parser", "UsageError", "at_least"]

OUT_HELP = "results: a new or empty folder, or one of an earlier run of this command (default: %(default)s)"


class UsageError(SlamInitError):
    """The command line itself is wrong."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, told by :func:`main` like all others."""

    def print_help(self, file: SupportsWrite[str] | None = None) -> None:
        """Print the help; a closed pipe is no error.

        Parameters
        ----------
        file : file, optional
            Ignored: help goes to stdout.
        """
        tell(self.format_help())

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong with the arguments.

        Parameters
        ----------
        message : str

        Raises
        ------
        UsageError
        """
        raise UsageError(f"{message} (see {self.prog} --help)")


def at_least(option: str, value: float | None, least: int) -> None:
    """Check an option that has a smallest value.

    Parameters
    ----------
    option : str
        Its name, as in ``--start``.
    value : float or None
        None if the option is not given.
    least : int

    Raises
    ------
    UsageError
    """
    if value is not None and value < least:
        raise UsageError(f"{option} is {value}: it must be at least {least}")
