"""The parser of the commands, and what several commands check."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from slam_init.errors import SlamInitError
from slam_init.system.process_io import tell

if TYPE_CHECKING:
    from _typeshed import SupportsWrite


Commands: TypeAlias = "argparse._SubParsersAction[Parser]"
DONE, BAD_INPUT, NOT_INITIALIZED = 0, 2, 3
#: Of ``slam-init audit``: the tracks do not tell, as where they do not allow a map; they contradict the map.
DOUBTFUL, WRONG = NOT_INITIALIZED, 4
#: Added to the number of the signal.
INTERRUPTED = 128


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

    # Called for each value. All words of a command are a value as well, that of the action of the commands.
    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        bare = any(self.bare_values.get(option) == "" for option in action.option_strings)
        if not arg_string and not bare and action.nargs != argparse.PARSER:
            # As a path, the value of a variable that the shell does not know would be the current folder.
            raise UsageError(f"{'/'.join(action.option_strings) or action.metavar} is empty: give a value")
        return super()._get_value(action, arg_string)

    def print_help(self, file: SupportsWrite[str] | None = None) -> None:
        """Print the help; a closed pipe is no error."""
        tell(self.format_help())

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong with the arguments, with the name that was meant."""
        from difflib import get_close_matches

        wrong = re.search(r"(?:arguments: |invalid choice: ')([\w-]+)(?=[\s'=]|$)", message)
        if wrong is not None and (near := get_close_matches(wrong[1], self._names(), n=1)):
            message += f": did you mean {near[0]}?"
        if len(message) > _LONGEST:  # a number of 5,000 digits
            message = f"{message[: _LONGEST // 2]}...{message[-_LONGEST // 4 :]}"
        raise UsageError(f"{message} (see {self.prog} --help)")

    def _names(self) -> list[str]:
        """All options and choices, those of the commands as well."""
        names = list(self._option_string_actions)
        for action in self._actions:
            names += action.choices or ()
            if isinstance(action.choices, dict):
                names += [name for command in action.choices.values() for name in command._names()]
        return names


class ListMethods(argparse.Action):
    """An option that takes the place of a command: it prints the names of the methods."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """List the methods and exit."""
        from slam_init.methods.registry import methods_text

        tell(methods_text())
        parser.exit()


def number(least: float, kind: type[float] = int) -> Callable[[str], float]:
    """Make what reads the value of an option that has a smallest value."""

    def read(text: str) -> float:
        value = kind(text)
        if not value >= least:  # nor is NaN
            raise argparse.ArgumentTypeError(f"{text} is too small: it must be at least {least}")
        return value

    read.__name__ = kind.__name__
    return read
