"""The text of an external method: ``command:PROGRAM {images} {times} {camera} {out}``.

The program may be in any language. ``NAME=command:PROGRAM ...`` gives the method a name for tables and charts.
Otherwise it has the name of its script or program. The text is split into words by the rules of a shell
(:mod:`shlex`), but no shell runs. The placeholders are replaced after the split, so that a folder with spaces remains
one word.
"""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath

from slam_init.errors import ConfigError

COMMAND = "command:"
_NAMED = re.compile(r"([^\s=:]+)=command:")
_NAME = re.compile(r"[A-Za-z0-9_.+-]{1,40}")
#: Programs that run a script: the script names the method.
_INTERPRETERS = re.compile(
    r"(python|pypy|ruby|perl|node|bash|sh|dash|zsh|env|julia|Rscript|java|docker|pixi|uv|run)[\d.]*"
)
_LONGEST_LABEL = 40
_USAGE = "'command:PROGRAM {images} {times} {camera} {out}'"


@dataclass(frozen=True)
class ExternalCommand:
    """An external program that initializes from a folder of frames."""

    #: Name in tables and charts.
    label: str
    #: Program and arguments, with placeholders.
    words: tuple[str, ...]

    def filled(self, values: Mapping[str, str]) -> list[str]:
        """Replace the placeholders, which are the names of the values."""
        pattern = re.compile("{(" + "|".join(values) + ")}")
        return [pattern.sub(lambda found: values[found[1]], word) for word in self.words]


def is_external(method: str) -> bool:
    """Return whether a method is an external program."""
    return method.startswith(COMMAND) or _NAMED.match(method) is not None


def method_label(method: str) -> str:
    """Return the name of a method for tables and charts.

    * Returns: The label of an external program; the file without its folder; other methods have their own name.
    """
    if not is_external(method):
        place, _, attribute = method.rpartition(":")
        return f"{PurePath(place).stem}:{attribute}" if place.endswith(".py") else method
    try:
        return _split(method).label
    except ConfigError:  # a journal of another program
        return method[:_LONGEST_LABEL]


def parse_external(method: str) -> ExternalCommand:
    """Parse and check the text of an external method."""
    command = _split(method)
    if not method.startswith(COMMAND) and not _NAME.fullmatch(command.label):
        shown = command.label[:60]
        raise ConfigError(f"the name {shown!r} of a method: give at most 40 letters, digits and any of _.+-")
    # Without these two a program can neither read frames nor return a trajectory.
    missing = [name for name in ("{images}", "{out}") if not any(name in word for word in command.words)]
    if missing:
        raise ConfigError(f"the method {method!r} lacks {' and '.join(missing)}: give {_USAGE}")
    if shutil.which(command.words[0]) is None:
        raise ConfigError(f"the method {method!r}: the program {command.words[0]!r} is not found, or is not executable")
    return command


def _split(method: str) -> ExternalCommand:
    prefix, _, text = method.partition(COMMAND)
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ConfigError(f"the method {method!r} cannot be split into words ({error}): check its quotes") from None
    if not words or "\0" in text:
        raise ConfigError(f"the method {method!r} names no program: give {_USAGE}")
    return ExternalCommand(prefix.removesuffix("=") or _label(words), tuple(words))


def _label(words: Sequence[str]) -> str:
    """Return the name of the script, or of the program."""
    named = (PurePath(word).name for word in words if not word.startswith("-") and not set(word) & set("{ \t\n"))
    names = [name for name in named if name and not _INTERPRETERS.fullmatch(name)]
    return (names[0] if names else PurePath(words[0]).name)[:_LONGEST_LABEL]
