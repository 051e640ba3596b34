"""The parser of the commands, and what several commands check."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from slam_init.errors import SlamInitError
from slam_init.system.process_io import emit

if TYPE_CHECKING:
    from _typeshed import SupportsWrite


Commands: TypeAlias = "argparse._SubParsersAction[Parser]"
DONE, BAD_INPUT, NOT_INITIALIZED = 0, 2, 3
#: Of ``slam-init audit``: the tracks do not decide, as where they do not allow a map; they contradict the map.
DOUBTFUL, WRONG = NOT_INITIALIZED, 4
#: Added to the number of the signal.
INTERRUPTED = 128


OUT_HELP = "results: a new or empty folder, or one of an earlier run of this command (default: %(default)s)"


#: A longer message repeats what somebody typed, or a whole file.
_LONGEST = 400


class UsageError(SlamInitError):
    """The command line itself is wrong."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, reported by :func:`main` like all others."""

    # The signature of argparse has overloads that say nothing more.
    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse words. An option that does not exist is reported by the command that it was given to."""
        arguments, unknown = super().parse_known_args(args, namespace)
        if unknown:
            nearest = get_close_matches(unknown[0], self._option_string_actions, n=1)
            meant = f": did you mean {nearest[0]}?" if nearest else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{meant}")
        for name, value in vars(arguments).items():
            # As a path, the value of a variable that the shell does not know would be the current folder.
            if value == "" or (isinstance(value, list) and "" in value):
                self.error(f"{name} is empty: give a value")
        return arguments, unknown

    def print_help(self, file: SupportsWrite[str] | None = None) -> None:
        """Print the help; a closed pipe is no error."""
        emit(self.format_help())

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong with the arguments."""
        if len(message) > _LONGEST:  # a number of 5,000 digits
            message = f"{message[: _LONGEST // 2]}...{message[-_LONGEST // 4 :]}"
        raise UsageError(f"{message} (see {self.prog} --help)")


def add_command(
    commands: Commands, name: str, run: Callable[[argparse.Namespace], int], help_: str, description: str
) -> Parser:
    """Add a command.

    * ``run``: Takes the arguments, and returns the exit code.
    * ``help_``: The line in the list of the commands.
    """
    parser = commands.add_parser(name, help=help_, description=description, allow_abbrev=False)
    parser.set_defaults(command=run)
    return parser


class Print(argparse.Action):
    """An option that takes the place of a command: it prints the text that the function ``const`` returns."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """Print the text and exit."""
        assert callable(self.const)
        emit(self.const())
        parser.exit()


def add_list_methods(parser: argparse._ActionsContainer) -> None:
    """Add the option that lists the methods."""

    def methods() -> str:
        from slam_init.methods.registry import methods_text

        return methods_text()

    text = "list the methods, one a line, and exit"
    parser.add_argument("--list-methods", action=Print, nargs=0, const=methods, help=text)


def add_options(
    parser: argparse._ActionsContainer,
    helps: Mapping[str, str],
    types: Mapping[str, Callable[[str], object]] | None = None,
    **defaults: object,
) -> None:
    """Add options.

    * ``helps``: The help of each option by its usage: ``--seed N`` takes a value, ``--live [URL]`` may take one and is
      True without it, and ``--json`` takes none and is True or False.
    * ``types``: What reads the value of an option, by its name; text without it.
    * ``defaults``: The values of options that are not given, by their names in the arguments; else None, or False.
    """
    for usage, text in helps.items():
        name, _, value = usage.partition(" ")
        if not value:
            parser.add_argument(name, action="store_true", help=text)
            continue
        kind = (types or {}).get(name, str)
        given: dict[str, Any] = {"nargs": "?", "const": True} if value.startswith("[") else {}
        parser.add_argument(name, metavar=value.strip("[]"), type=kind, help=text, **given)
    parser.set_defaults(**defaults)


def refuse_changed(arguments: argparse.Namespace, defaults: Mapping[str, object], why: str) -> None:
    """Refuse options that have other values than these defaults; ``why`` is said before the name of the option."""
    for name, default in defaults.items():
        if getattr(arguments, name) != default:
            raise UsageError(f"{why} --{name.replace('_', '-')}: leave it out")


def number(least: float, kind: type[float] = int, most: float = math.inf) -> Callable[[str], float]:
    """Make what reads the value of an option that has a smallest and a largest value."""

    def read(text: str) -> float:
        value = kind(text)
        if not least <= value <= most:  # nor is NaN
            bounds = f"at least {least}" if most == math.inf else f"from {least} to {most}"
            raise argparse.ArgumentTypeError(f"{text} is out of range: it must be {bounds}")
        return value

    read.__name__ = kind.__name__
    return read
