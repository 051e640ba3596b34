"""Live sources: a camera of this machine, a network stream, and a video on the standard input.

The names are read here; :mod:`~slam_init.datasets.live.source` receives images and makes a source of them.
"""

from __future__ import annotations

import re
from functools import partial

from slam_init.datasets.live.source import LiveSource, read_camera, read_pipe, read_url
from slam_init.errors import SourceError

_PIPE = "-"
_CAMERA = "camera:"
_URL = re.compile(r"(rtsps?|https?)://[^/\s]", re.IGNORECASE)
_PASSWORD = re.compile(r"(?<=://)[^/@\s]*@")


def is_live(text: str) -> bool:
    """Tell whether a name is that of a live source.

    * Returns: True for ``camera:N``, ``rtsp://...``, ``http://...``, ``https://...`` and ``-``.
    """
    return text == _PIPE or text.startswith(_CAMERA) or _URL.match(text) is not None


def open_live(text: str, *, keep_all: bool = False) -> LiveSource:
    """Open a live source. Nothing is connected before its frames are asked for.

    * ``text``: ``camera:N``, ``rtsp://...``, ``http://...``, ``https://...``, or ``-`` for the standard input, whose
      writer always waits.
    """
    if text == _PIPE:
        return LiveSource("standard input", partial(read_pipe, "standard input", 0), keep_all=True)
    if text.startswith(_CAMERA):
        number = text.removeprefix(_CAMERA)
        if not (number.isascii() and number.isdecimal() and len(number) < 4):
            raise SourceError(f"{text!r}: give the number of a camera, as in camera:0")
        return LiveSource(text, partial(read_camera, text, int(number)), keep_all=keep_all)
    if _URL.match(text) is None:
        raise SourceError(f"{text!r}: is no live source: give camera:0, an rtsp or http address, or -")
    name = without_password(text)
    return LiveSource(name, partial(read_url, name, text), keep_all=keep_all)


def without_password(text: str) -> str:
    """Remove user and password from the addresses in a text."""
    return _PASSWORD.sub("", text)
