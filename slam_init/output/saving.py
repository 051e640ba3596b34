"""Writes a map or a result that somebody holds in Python, with the files of a run."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass

from slam_init.errors import OutputError
from slam_init.output.colmap import colmap_model
from slam_init.output.folder import OutputFolder
from slam_init.output.names import COLMAP_FILES, run_files
from slam_init.output.results import map_files, publish_files, write_results
from slam_init.output.summary import summary_of
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Trajectory
from slam_init.types.result import Result


@dataclass(frozen=True)
class _FromPython:
    """The source of a result whose frames came from the caller."""

    name: str = "python"
    kind: str = "frames"
    camera: Camera | None = None
    groundtruth: Trajectory | None = None

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        yield from ()


def save(thing: object, folder: str | os.PathLike[str]) -> None:
    """Write a map or a result to a folder, see :meth:`slam_init.types.savable.Savable.save`."""
    if isinstance(thing, InitialMap):
        with OutputFolder(folder, "run", run_files(restart=False)) as out:
            publish_files(out, map_files(thing))
    elif isinstance(thing, Result):
        if thing.camera is None:
            raise OutputError(f"{folder}: the result has no camera: take that of an Initializer, or save its map")
        write_results(folder, thing, summary_of(thing, _FromPython(), thing.camera, thing.method, thing.seed))


def write_colmap(map_: InitialMap, folder: str | os.PathLike[str]) -> None:
    """Write a map as a COLMAP text model: ``cameras.txt``, ``images.txt``, ``points3D.txt``.

    Parameters
    ----------
    map_ : InitialMap
    folder : str or path
        A folder that is new, empty, or was written by an earlier call.

    Raises
    ------
    OutputError
        If the folder holds other files, or a file cannot be written.
    """
    names = [name.rpartition("/")[2] for name in COLMAP_FILES]
    with OutputFolder(folder, "colmap", names) as out:
        texts = colmap_model(map_)
        publish_files(out, {n: t.encode("utf-8", "surrogateescape") for n, t in zip(names, texts, strict=True)})
