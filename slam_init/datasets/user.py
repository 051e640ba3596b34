"""A data set of your own: ``python:package.module:attribute``, see :mod:`slam_init.examples.add_a_data_set`."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from slam_init.errors import SourceError

if TYPE_CHECKING:
    from slam_init.datasets.timed import TimedSource

__all__ = ["PYTHON", "open_python"]

PYTHON = "python:"
#: What a source has; see :class:`slam_init.datasets.timed.TimedSource`.
_PARTS = ("name", "kind", "camera", "groundtruth", "timestamps_s", "frames", "__len__")


def open_python(text: str) -> TimedSource:
    """Import an attribute and call it without arguments: it gives a :class:`~slam_init.datasets.timed.TimedSource`.

    Raises
    ------
    SourceError
        Where it cannot be imported or called, or what it gives is no source.
    """
    module, _, attribute = text.removeprefix(PYTHON).partition(":")
    try:
        source: TimedSource = getattr(import_module(module), attribute)()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise SourceError(f"{text}: cannot be opened ({error}): give python:package.module:attribute") from error
    if missing := [part for part in _PARTS if not hasattr(source, part)]:
        raise SourceError(f"{text}: what it gives is no source: it has no {missing[0]}")
    return source
