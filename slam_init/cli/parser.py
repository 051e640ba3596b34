"""The parser of the commands, and what several commands check."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from functools import cached_property
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
        try:
            namespace, unknown = self.parse_known_args(args, namespace)
        except UsageError as error:
            words = sys.argv[1:] if args is None else list(args)
            if "required: COMMAND" in str(error) and words:  # an option that does not exist hides the rest
                self.error(f"unrecognized arguments: {' '.join(words)}{_hint(words[0], self)}")
            raise
        if unknown:
            known = next((part.choices for part in self._actions if isinstance(part.choices, dict)), {})
            words = sys.argv[1:] if args is None else list(args)
            command = next((word for word in words if word in known), None)
            parser: Parser = self if command is None else known[command]
            before = words[words.index(unknown[0]) - 1]
            joined = f": did you mean {before}={unknown[0]}?" if before in parser.bare_values else ""
            parser.error(f"unrecognized arguments: {' '.join(unknown)}{joined or _hint(unknown[0], parser)}")
        return namespace

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
        """Raise what is wrong with the arguments."""
        if wrong := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message):
            meant = _meant(wrong[1], re.findall(r"[\w-]+", wrong[2]))
            if "COMMAND" in message and wrong[1] and (Path(wrong[1]).exists() or ":" in wrong[1]):
                meant = [f"{self.prog} run {wrong[1]}"]
            message += f": did you mean {meant[0]}?" if meant else ""
        if len(message) > _LONGEST:  # a number of 5,000 digits
            message = f"{message[: _LONGEST // 2]}...{message[-_LONGEST // 4 :]}"
        raise UsageError(f"{message} (see {self.prog} --help)")


class ListMethods(argparse.Action):
    """An option that takes the place of a command: it prints the names of the methods."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """List the methods and exit."""
        from slam_init.methods.registry import methods_text

        tell(methods_text())
        parser.exit()


#: What people call an option elsewhere. None: SOURCE stands without an option.
_OTHER_NAMES: dict[str, str | None] = {
    **dict.fromkeys(("--calib", "--calibration", "--intrinsics"), "--camera"),
    **dict.fromkeys(("--output", "--outdir", "--save"), "--out"),
    **dict.fromkeys(("--frames", "--num-frames", "--limit"), "--max-frames"),
    **dict.fromkeys(("--skip", "--step", "--stride"), "--every"),
    **dict.fromkeys(("--show", "--viewer", "--visualize"), "--live"),
    **dict.fromkeys(("--video", "--input", "--source", "--folder"), None),
}
#: The option that takes a file, by the end of its name.
_OPTION_OF_FILE = {".yaml": "--camera", ".yml": "--camera", ".xml": "--camera", ".toml": "--config", ".csv": "--imu"}


def _hint(word: str, parser: argparse.ArgumentParser) -> str:
    """The option that was meant, as the end of a message."""
    options = [option for part in parser._actions for option in part.option_strings]
    name, suffix = word.partition("=")[0], Path(word).suffix.lower()
    if not word.startswith("-") and _OPTION_OF_FILE.get(suffix) in options:
        option = _OPTION_OF_FILE[suffix]
        return f": did you mean {option}{'=' if option in getattr(parser, 'bare_values', {}) else ' '}{word}?"
    if name in _OTHER_NAMES and name not in options:
        other = _OTHER_NAMES[name]
        if other is None:
            return f": leave {name} out: SOURCE stands without an option"
        return f": did you mean {other}?" if other in options else ""
    meant = _meant(name, options)
    return f": did you mean {meant[0]}?" if meant else ""


def _meant(word: str, known: Sequence[str]) -> list[str]:
    """The name that was meant, if any: one with a slip of the fingers, or the only long option of a letter."""
    if re.fullmatch(r"-\w", word):
        long = [option for option in known if option.startswith(f"-{word}")]
        return long if len(long) == 1 else []
    return [name for name in known if _is_slip(word, name)]


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
