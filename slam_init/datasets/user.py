"""Data sets of the user: ``python:package.module:attribute``, see :mod:`slam_init.examples.add_a_data_set`."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from slam_init.errors import SourceError

if TYPE_CHECKING:
    from slam_init.datasets.timed import TimedSource

__all__ = ["PYTHON", "open_python"]

#: Prefix of the name of such a source.
PYTHON = "python:"
#: Attributes of a :class:`slam_init.datasets.timed.TimedSource`.
_REQUIRED_ATTRIBUTES = ("name", "kind", "camera", "groundtruth", "timestamps_s", "frames", "__len__")


def open_python(text: str) -> TimedSource:
    """Open a source by importing an attribute of a module and calling it without arguments.

    Parameters
    ----------
    text : str
        ``python:package.module:attribute``; the call returns a :class:`~slam_init.datasets.timed.TimedSource`.

    Returns
    -------
    TimedSource

    Raises
    ------
    SourceError
        If the attribute cannot be imported or called, or if it does not return a source.
    """
    module, _, attribute = text.removeprefix(PYTHON).partition(":")
    try:
        source: TimedSource = getattr(import_module(module), attribute)()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise SourceError(f"{text}: cannot be opened ({error}): give python:package.module:attribute") from error
    if missing := [name for name in _REQUIRED_ATTRIBUTES if not hasattr(source, name)]:
        raise SourceError(f"{text}: the returned object is not a source: it has no {missing[0]}")
    return source
