"""The names of the recordings of a comparison."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from urllib.parse import quote

from slam_init.methods.external_command import method_label
from slam_init.output.names import UNFINISHED

#: The folder of the recordings in that of the results.
RECORDINGS = "recordings"
#: The recording of all methods from one start.
SIDE_BY_SIDE = "side-by-side.rrd"
#: Largest length of a folder name in characters; file systems allow 255 bytes.
_MAX_NAME = 120


def recording_folder(recordings: str | os.PathLike[str], source: str, start: int) -> Path:
    """Return the folder of the recordings of one start."""
    return Path(recordings) / f"{quote(source, safe='').replace('%', '_')[-_MAX_NAME:]}-{start:06d}"


def recording_name(method: str) -> str:
    """Return the name of the recording of a trial in its folder.

    * Returns: The colon becomes a hyphen; other special characters become percent codes.
    """
    return f"{_file_name(method)}.rrd"


def snapshot_name(method: str) -> str:
    """Return the name of the snapshot of the map of a trial, beside its recording."""
    return f"{_file_name(method)}.npz"


def names_of_start(source: str, start: int, methods: Iterable[str]) -> Iterator[str]:
    """Return all files that the trials of one start may write."""
    folder = recording_folder(RECORDINGS, source, start)
    for name in (
        SIDE_BY_SIDE,
        *(name for method in methods for name in (recording_name(method), snapshot_name(method))),
    ):
        yield (folder / name).as_posix()
        if name.endswith(".rrd"):  # its name until it is complete
            yield (folder / name).with_suffix(UNFINISHED).as_posix()


def _file_name(method: str) -> str:
    return quote(method_label(method), safe="").replace("%3A", "-")
