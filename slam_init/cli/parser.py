"""The parser of the commands, and what several commands check."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Sequence
from itertools import takewhile
from pathlib import Path
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
    """A parser whose errors are one line, reported by :func:`main` like all others."""

    # The signature of argparse has overloads that say nothing more.
    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse words. An option that does not exist is reported by the command that it was given to."""
        arguments, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}{_hint(unknown[0], self)}")
        for name, value in vars(arguments).items():
            # As a path, the value of a variable that the shell does not know would be the current folder.
            if value == "" or (isinstance(value, list) and "" in value):
                self.error(f"{name} is empty: give a value")
        return arguments, unknown

    def print_help(self, file: SupportsWrite[str] | None = None) -> None:
        """Print the help; a closed pipe is no error."""
        tell(self.format_help())

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong with the arguments."""
        if wrong := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message):
            meant = _meant(wrong[1], re.findall(r"[\w-]+", wrong[2]))
            if "COMMAND" in message and wrong[1] and (Path(wrong[1]).exists() or ":" in wrong[1]):
                meant = f"{self.prog} run {wrong[1]}"
            message += f": did you mean {meant}?" if meant else ""
        if len(message) > _LONGEST:  # a number of 5,000 digits
            message = f"{message[: _LONGEST // 2]}...{message[-_LONGEST // 4 :]}"
        raise UsageError(f"{message} (see {self.prog} --help)")


class Tells(argparse.Action):
    """An option that takes the place of a command: it prints the text that the function ``const`` returns."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """Print the text and exit."""
        assert callable(self.const)
        tell(self.const())
        parser.exit()


def add_list_methods(parser: argparse._ActionsContainer) -> None:
    """Add the option that lists the methods."""

    def methods() -> str:
        from slam_init.methods.registry import methods_text

        return methods_text()

    text = "list the methods, one a line, and exit"
    parser.add_argument("--list-methods", action=Tells, nargs=0, const=methods, help=text)


#: What people call an option elsewhere: the options that are meant, of which a command has one at most.
_OTHER_NAMES = {
    **dict.fromkeys(("--calib", "--calibration", "--intrinsics"), ("--camera",)),
    **dict.fromkeys(("-o", "--output", "--outdir", "--save"), ("--out",)),
    **dict.fromkeys(("--max-frames", "--frames", "--num-frames", "--limit"), ("--max-frames", "--limit-frames")),
    **dict.fromkeys(("--skip", "--step", "--stride"), ("--use-every", "--every")),
    **dict.fromkeys(("--show", "--viewer", "--visualize"), ("--live",)),
    **dict.fromkeys(("-j", "--threads", "--workers", "--processes"), ("--jobs",)),
    "--timeout": ("--time-limit",),
    "--memory": ("--memory-limit",),
}
#: SOURCE stands without an option.
_SOURCE_NAMES = ("--video", "--input", "--source", "--folder", "--dataset", "--sequence")
#: The option that takes a file, by the end of its name.
_OPTION_OF_FILE = {".yaml": "--camera", ".yml": "--camera", ".xml": "--camera", ".toml": "--config", ".csv": "--imu"}


def _hint(word: str, parser: argparse.ArgumentParser) -> str:
    """The option that was meant, as the end of a message."""
    options = [option for part in parser._actions for option in part.option_strings]
    name, option = word.partition("=")[0], _OPTION_OF_FILE.get(Path(word).suffix.lower())
    if not word.startswith("-") and option in options:
        return f": did you mean {option} {word}?"
    if name in _SOURCE_NAMES:
        return f": leave {name} out: SOURCE stands without an option"
    others = (option for option in _OTHER_NAMES.get(name, ()) if option in options)
    meant = next(others, None) or _meant(name, options)
    return f": did you mean {meant}?" if meant else ""


def _meant(word: str, known: Sequence[str]) -> str | None:
    """The name that was meant, if any: one with a slip of the fingers."""
    return next((name for name in known if _is_slip(word, name)), None)


def _is_slip(word: str, name: str) -> bool:
    """Whether a letter was added, left out or replaced, or two neighbours were exchanged: the meaning is the same."""
    same = takewhile(lambda pair: pair[0] == pair[1], zip(word, name, strict=False))
    first = len(list(same))
    a, b = word[first:], name[first:]
    return word != name and (a[1:] == b or a == b[1:] or a[1:] == b[1:] or (a[1::-1], a[2:]) == (b[:2], b[2:]))


def number(least: float, kind: type[float] = int) -> Callable[[str], float]:
    """Make what reads the value of an option that has a smallest value."""

    def read(text: str) -> float:
        value = kind(text)
        if not value >= least:  # nor is NaN
            raise argparse.ArgumentTypeError(f"{text} is too small: it must be at least {least}")
        return value

    read.__name__ = kind.__name__
    return read
