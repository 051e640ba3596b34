"""Opens the source that the user names. This module is the only one that detects the kind of a source."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from slam_init.datasets.euroc import find_euroc_camera, open_euroc
from slam_init.datasets.folder import open_folder
from slam_init.datasets.image_files import IMAGE_SUFFIXES, holds_image
from slam_init.datasets.kitti import find_kitti_images, open_kitti
from slam_init.datasets.synth import PREFIX, open_synth
from slam_init.datasets.timed import TimedSource
from slam_init.datasets.tum import INDEX_FILES, open_tum
from slam_init.datasets.user import PYTHON, open_python
from slam_init.datasets.video import open_video
from slam_init.errors import SourceError
from slam_init.regular_file import kind_problem, user_path

__all__ = ["detect_kind", "open_source"]


def open_source(text: str | os.PathLike[str], seed: int = 0) -> TimedSource:
    """Open a folder, a video file, ``synth:NAME`` or ``python:package.module:attribute``.

    Parameters
    ----------
    text : str or path-like
        A path, or the name of a source in one of the forms above.
    seed : int
        Seed of a synthetic sequence; ignored for other sources.

    Returns
    -------
    TimedSource

    Raises
    ------
    SourceError, CalibrationError
        If there is nothing to read, or if a file is broken. The message is one line that says what to do.
    """
    text = os.fspath(text)
    kind = detect_kind(text)
    if kind == "synth":
        return open_synth(text, seed)
    if kind == "python":
        return open_python(text)
    path = user_path(text)
    openers: dict[str, Callable[[Path], TimedSource]] = {
        "tum": open_tum,
        "euroc": open_euroc,
        "kitti": open_kitti,
        "images": open_folder,
        "video": open_video,
    }
    try:
        return openers[kind](path)
    except OSError as error:
        raise SourceError(f"{error.filename or path}: cannot be read ({error.strerror})") from None


def detect_kind(text: str | os.PathLike[str]) -> str:
    """Detect the kind of a source. The layouts of folders are tried in a fixed order, and the first that fits is taken.

    Parameters
    ----------
    text : str or path-like
        As of :func:`open_source`.

    Returns
    -------
    str
        One of ``tum``, ``euroc``, ``kitti``, ``images``, ``video``, ``synth`` and ``python``.

    Raises
    ------
    SourceError
        If nothing fits; the message lists the known layouts.
    """
    text = os.fspath(text)
    if text.startswith(PREFIX):
        return "synth"
    if text.startswith(PYTHON):
        return "python"
    path = user_path(text)
    try:
        if path.is_dir():
            return _detect_folder(path)
        if path.is_file():
            return _detect_file(path)
        missing = not path.exists()
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        cause = getattr(error, "strerror", None) or error
        raise SourceError(f"{text!r}: cannot be read ({cause})") from None
    if missing:
        raise SourceError(f"{text!r}: no such file or folder; give one, or synth:NAME")
    raise SourceError(f"{path} {kind_problem(path)}")


def _detect_folder(path: Path) -> str:
    if any((path / name).is_file() for name in INDEX_FILES):
        return "tum"
    if find_euroc_camera(path):
        return "euroc"
    if find_kitti_images(path):
        return "kitti"
    if holds_image(path) or ((path / "images").is_dir() and holds_image(path / "images")):
        return "images"
    raise SourceError(
        f"{path}: no sequence in this folder; looked for {', '.join(INDEX_FILES)} (TUM), "
        "mav0/cam0/data.csv (EuRoC), image_0 or image_2 (KITTI), images in it or in images/"
    )


def _detect_file(path: Path) -> str:
    if path.suffix.lower() in IMAGE_SUFFIXES:
        raise SourceError(f"{path}: one image is not a sequence: give the folder {path.parent}")
    return "video"
