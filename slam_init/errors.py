"""Exceptions for errors of the caller or of the data.

A scene that does not allow initialization is not an error: the result is then a
:class:`slam_init.types.result.Result` with a ``reason``. An exception of this module means that the user has to change
an argument or a file. Its message is one line that names the error and the remedy. The command line prints this line
and exits with code 2.
"""

from __future__ import annotations

import os
import re
import sysconfig
from pathlib import Path
from traceback import extract_tb

# Control characters, line separators, halves of surrogate pairs, and marks that turn the direction of the text. A file
# name may hold any of them, and with them a message could look like another one.
_NOT_PLAIN = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")

# Longest message. A path may have 4096 characters and stands at the start.
_LONGEST = 10_000


def plain_line(text: str) -> str:
    r"""Escape the characters of a text that are no plain text in one line.

    Parameters
    ----------
    text : str
        For example with the name of a file.

    Returns
    -------
    str
        Line breaks, other control characters, surrogates and marks of the direction of writing are written as in
        Python: ``\n``, ``\x1b``, ``\u202e``. All other characters stay.
    """
    return _NOT_PLAIN.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def place_of(error: BaseException) -> str:
    """Name the innermost line of the user's own code that an error passed.

    Parameters
    ----------
    error : BaseException
        Raised by a method, a matcher or a reader of the user.

    Returns
    -------
    str
        A space, then the place, as in ``at my_method.py:14``; empty where the error passed no such line.
    """
    # Of others are the folders of this package, of Python, and of what is installed, and code without a file.
    folders = (Path(__file__).parent, *map(sysconfig.get_path, ("stdlib", "purelib", "platlib")))
    others = ("<", *(f"{folder}{os.sep}" for folder in folders))
    own = [at for at in extract_tb(error.__traceback__) if not at.filename.startswith(others)]
    return f" at {Path(own[-1].filename).name}:{own[-1].lineno}" if own else ""


class SlamInitError(Exception):
    """Base of all exceptions of this package. The message is one line for the user.

    Parameters
    ----------
    message : str
        Characters that are no plain text, as in names of files, are escaped (:func:`plain_line`). A message of more
        than 10,000 characters is shortened in its middle.
    """

    def __init__(self, message: str) -> None:
        if len(message) > _LONGEST:
            # A name in a file may have a million characters. The remedy stands at the end.
            message = f"{message[: _LONGEST // 2]} ... {message[-_LONGEST // 2 :]}"
        super().__init__(plain_line(message))


class SourceError(SlamInitError):
    """A video, folder or image cannot be read."""


class CalibrationError(SlamInitError):
    """A camera calibration is missing, unreadable or impossible."""


class ConfigError(SlamInitError):
    """A configuration file or option has an unknown name, or a value that is out of range."""


class OutputError(SlamInitError):
    """Results cannot be written to the requested place."""


class ViewerError(SlamInitError):
    """A recording cannot be shown: there is no viewer, no display or no graphics driver."""


def check_type(
    value: object, wanted: type | tuple[type, ...], what: str, give: str, error: type[SlamInitError] = SlamInitError
) -> None:
    """Refuse an argument of a wrong type: an attribute that it has not would be reported far from the call.

    Parameters
    ----------
    value : object
        The argument.
    wanted : type or tuple of types
        What it may be. A truth value is no integer.
    what : str
        The name of the argument with its article.
    give : str
        What to give.
    error : type of SlamInitError
        What is raised.
    """
    if not isinstance(value, wanted) or (isinstance(value, bool) and wanted is not bool):
        raise error(f"{what} is of the type {type(value).__name__}: give {give}")
