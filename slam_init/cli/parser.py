"""The parser of the commands, and what several commands check."""

from __future__ import annotations

import argparse
import re
import sys
from difflib import get_close_matches
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from slam_init.errors import SlamInitError
from slam_init.system.process_io import tell

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

    Commands: TypeAlias = "argparse._SubParsersAction[Parser]"

OUT_HELP = "results: a new or empty folder, or one of an earlier run of this command (default: %(default)s)"


#: A longer message repeats what somebody typed, or a whole file.
_LONGEST = 400


class UsageError(SlamInitError):
    """The command line itself is wrong."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, reported by :func:`main` like all others.

    An option in :attr:`bare_values` may stand without a value. A value stands behind ``=``: the next word is never one,
    so that the option may stand before SOURCE.
    """

    @cached_property
    def bare_values(self) -> dict[str, str]:
        """Values of options that stand bare."""
        return {}

    # The signature of argparse has overloads that say nothing more.
    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse words, after the values of options that stand bare were added."""
        words = sys.argv[1:] if args is None else list(args)
        end = words.index("--") if "--" in words else len(words)
        bare = self.bare_values
        given = [f"{word}={bare[word]}" if word in bare else word for word in words[:end]]
        return super().parse_known_args([*given, *words[end:]], namespace)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse words; an option that does not exist is reported with the command that it was given to."""
        namespace, unknown = self.parse_known_args(args, namespace)
        if unknown:
            known = next((part.choices for part in self._actions if isinstance(part.choices, dict)), {})
            words = sys.argv[1:] if args is None else list(args)
            command = next((word for word in words if word in known), None)
            parser: Parser = self if command is None else known[command]
            options = [option for part in parser._actions for option in part.option_strings]
            meant = get_close_matches(unknown[0].partition("=")[0], options, n=1)
            hint = f": did you mean {meant[0]}?" if meant else ""
            parser.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
        return namespace

    def print_help(self, file: SupportsWrite[str] | None = None) -> None:
        """Print the help; a closed pipe is no error."""
        tell(self.format_help())

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong with the arguments."""
        if wrong := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message):
            meant = get_close_matches(wrong[1], re.findall(r"[\w-]+", wrong[2]), n=1)
            message += f": did you mean {meant[0]}?" if meant else ""
        if len(message) > _LONGEST:  # a number of 5,000 digits
            message = f"{message[: _LONGEST // 2]}...{message[-_LONGEST // 4 :]}"
        raise UsageError(f"{message} (see {self.prog} --help)")


def at_least(option: str, value: float | None, least: int) -> None:
    """Check an option that has a smallest value."""
    if value is not None and value < least:
        raise UsageError(f"{option} is {value}: it must be at least {least}")
