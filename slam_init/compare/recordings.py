"""The names of the recordings of a comparison."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

if TYPE_CHECKING:
    from slam_init.compare.plan import Plan

__all__ = ["RECORDINGS", "SIDE_BY_SIDE", "planned_recordings", "recording_folder", "recording_name", "snapshot_name"]

#: The folder of the recordings in that of the results.
RECORDINGS = "recordings"
#: The recording of all methods from one start.
SIDE_BY_SIDE = "side-by-side.rrd"
#: Largest length of a folder name in characters; file systems allow 255 bytes.
_MAX_NAME = 120


def recording_folder(recordings: str | os.PathLike[str], source: str, start: int) -> Path:
    """Return the folder of the recordings of one start.

    Parameters
    ----------
    recordings : str or os.PathLike
        Folder of all recordings.
    source : str
        Label of the source.
    start : int
        Start frame.

    Returns
    -------
    Path
        The folder; it is not created.
    """
    return Path(recordings) / f"{quote(source, safe='').replace('%', '_')[-_MAX_NAME:]}-{start:06d}"


def recording_name(method: str) -> str:
    """Return the name of the recording of a trial in its folder.

    Parameters
    ----------
    method : str
        Name, or ``package.module:attribute``.

    Returns
    -------
    str
        The colon becomes a hyphen; other special characters become percent codes.
    """
    return f"{_file_name(method)}.rrd"


def snapshot_name(method: str) -> str:
    """Return the name of the snapshot of the map of a trial, beside its recording.

    Parameters
    ----------
    method : str
        Name, or ``package.module:attribute``.

    Returns
    -------
    str
        As :func:`recording_name`.
    """
    return f"{_file_name(method)}.npz"


def planned_recordings(plan: Plan) -> Iterator[str]:
    """Return all files that the trials of a plan may write.

    Parameters
    ----------
    plan : Plan

    Yields
    ------
    str
        Relative to the folder of the results, with slashes.
    """
    for source in plan.sources:
        for start in plan.starts(source):
            folder = recording_folder(RECORDINGS, source.label, start)
            names = [name for method in plan.methods for name in (recording_name(method), snapshot_name(method))]
            for name in (*names, SIDE_BY_SIDE):
                yield (folder / name).as_posix()
                if name.endswith(".rrd"):  # its name until it is complete
                    yield (folder / name).with_suffix(".partial.rrd").as_posix()


def _file_name(method: str) -> str:
    return quote(method, safe="").replace("%3A", "-")
