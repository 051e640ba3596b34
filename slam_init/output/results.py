"""The results of a run on disk.

A folder holds exactly one run. A run with one map::

    summary.json                the summary, as ``--json`` prints it
    trajectory.txt              TUM format: world_from_cam of the keyframes
    map.ply                     the landmarks with their colours, binary
    colmap/                     text model of the original images (cameras.txt, images.txt, points3D.txt)
    graph.txt, values.txt       factor graph and estimate as gtsam's text archives
    handover.npz                the map as arrays for another system (slam_init.output.handover)
    transforms.json             the cameras for nerfstudio, in the axes of OpenGL
    continued.txt               TUM format: world_from_cam of the frames that were located after the initialization
    scene/                      with ``--export scene``: the map with its images (slam_init.output.scene)
    config.toml                 the resolved configuration
    overview.png                the run in one picture
    recording.rrd               the recording
    interrupted.rrd             the recording of a later run that was interrupted, up to its end

A run that restarts after a loss writes the files of each map to a folder of its own: ``segment-001/trajectory.txt``
and so on. The summary, the configuration and the recording are those of the run.

:mod:`slam_init.output.folder` states how the results replace those of an earlier run: all of them, or none. The summary
is the last file that is put, so a folder with a summary is complete.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

from slam_init.errors import OutputError, SourceError
from slam_init.output.colmap import colmap_model, numbers_text
from slam_init.output.folder import OutputFolder
from slam_init.output.handover import handover_bytes
from slam_init.output.names import COLMAP_FILES, OVERVIEW, segment_folder
from slam_init.output.plain_json import json_text
from slam_init.output.scene import coloured_points, transforms_text
from slam_init.output.summary import SourceRecord, Summary, provenance_of, summary_of
from slam_init.system.regular_file import read_regular, user_path
from slam_init.types.initial_map import Descriptors, InitialMap, Keyframe
from slam_init.types.result import Result

#: A map of 100,000 observations takes 20 MB.
_MAX_ARCHIVE_BYTES = 500_000_000
#: Bounds of the process that tries an archive: a sound one of the largest size takes a tenth of them.
_CHILD_S, _CHILD_BYTES = 120, 16_000_000_000
_READ_BY_CHILD = """
import resource, sys
import gtsam
limit, hard = int(sys.argv[1]), resource.getrlimit(resource.RLIMIT_AS)[1]
limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
graph, values = sys.stdin.read().split("\\0")
gtsam.NonlinearFactorGraph().deserialize(graph)
gtsam.Values().deserialize(values)
"""
_SUMMARY, _GRAPH, _VALUES = "summary.json", "graph.txt", "values.txt"


def publish_results(
    folder: OutputFolder,
    result: Result,
    summary: Summary,
    config_toml: str | None = None,
    continued: Sequence[Keyframe] = (),
    overview: bytes | None = None,
    descriptors: Sequence[Descriptors] = (),
) -> None:
    """Write all results, and replace those of the earlier run by them and by what is staged.

    * ``continued``: The frames that were located after the initialization; those of segments are in the result.
    * ``descriptors``: Those of each map; maps beyond have none.
    """
    files: dict[str, bytes] = {} if overview is None else {OVERVIEW: overview}
    maps = maps_of(result, continued)
    for (prefix, map_, located), described in zip_longest(maps, descriptors[: len(maps)]):
        files |= {f"{prefix}{name}": content for name, content in map_files(map_, located, described).items()}
    if config_toml is not None:
        files["config.toml"] = config_toml.encode()
    files[_SUMMARY] = json_text(summary).encode()
    folder.write(files)
    folder.publish(last=_SUMMARY)


def maps_of(result: Result, continued: Sequence[Keyframe]) -> list[tuple[str, InitialMap, Sequence[Keyframe]]]:
    """The maps of a result, each with the folder of its files and its frames after the initialization.

    * ``continued``: Those of a result without segments.
    """
    if not result.segments and result.map is not None:
        return [("", result.map, continued)]
    return [(f"{segment_folder(n)}/", one.map, one.located) for n, one in enumerate(result.segments, start=1)]


def map_files(
    map_: InitialMap, located: Sequence[Keyframe] = (), descriptors: Descriptors | None = None
) -> dict[str, bytes]:
    """Return the content of the files of a map by name."""
    files = {"trajectory.txt": tum_text(map_.keyframes).encode()}
    # The map of an external program has no landmarks, and no graph to go on with.
    if map_.graph is None:
        return files
    comments = (
        "world frame: the first keyframe's camera, x right, y down, z forward",
        f"unit: {'the median depth in the first view' if map_.scale is None else 'metre'}",
    )
    files["map.ply"] = coloured_points(map_.points, map_.colors, comments)
    files |= zip(COLMAP_FILES, colmap_model(map_).texts(), strict=True)
    files[_GRAPH] = map_.graph.serialize().encode()
    files[_VALUES] = map_.values.serialize().encode()
    files["handover.npz"] = handover_bytes(map_, located, descriptors)
    transforms = transforms_text(map_, located)
    if transforms is not None:
        files["transforms.json"] = transforms.encode()
    if located:
        files["continued.txt"] = tum_text(located).encode()
    return files


def load_graph(out: str | os.PathLike[str]) -> tuple[Any, Any]:
    """Read the factor graph of a run, to continue with it in gtsam.

    Parameters
    ----------
    out : str or path
        Folder of a run that initialized, or of one of its segments.

    Returns
    -------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Keys as in :class:`slam_init.types.initial_map.InitialMap`.

    Raises
    ------
    SourceError
        If the folder holds no readable graph.
    """
    out = user_path(out)
    import gtsam

    if not (out / _GRAPH).exists():
        if (out / segment_folder(1)).is_dir():
            raise SourceError(f"{out} has a graph for each map: give {out / segment_folder(1)}")
        raise SourceError(f"no graph in {out}: give the folder of a run that initialized")
    texts = [
        read_regular(out / name, _MAX_ARCHIVE_BYTES, "a graph of gtsam", SourceError).decode("ascii", "replace")
        for name in (_GRAPH, _VALUES)
    ]
    # gtsam believes each count and class of an archive: damaged ones end the process. So a child reads it first.
    command = [sys.executable, "-c", _READ_BY_CHILD, str(_CHILD_BYTES)]
    try:
        subprocess.run(command, input="\0".join(texts).encode(), capture_output=True, timeout=_CHILD_S, check=True)
    except subprocess.SubprocessError:  # it failed, or did not end
        raise SourceError(f"the graph in {out} is damaged: run again") from None
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.deserialize(texts[0])
    values.deserialize(texts[1])
    return graph, values


def tum_text(keyframes: Sequence[Keyframe]) -> str:
    """Write a trajectory in TUM format.

    * Returns: One line ``timestamp tx ty tz qx qy qz qw`` for each keyframe: ``world_from_cam``, with w last.
    """
    return "".join(["# timestamp tx ty tz qx qy qz qw (world_from_cam)\n", *map(tum_line, keyframes)])


def tum_line(keyframe: Keyframe) -> str:
    """Write a line of a trajectory in TUM format."""
    w, x, y, z = keyframe.world_from_cam.q_wxyz
    numbers = numbers_text([*keyframe.world_from_cam.t, x, y, z, w])
    return f"{keyframe.timestamp_s:.9f} {numbers}\n"


def save(thing: object, folder: str | os.PathLike[str]) -> None:
    """Write a map or a result to a folder, see :meth:`slam_init.types.initial_map.Savable.save`."""
    if isinstance(thing, InitialMap):
        with OutputFolder(folder, "run") as out:
            out.write(map_files(thing))
            out.publish()
    elif isinstance(thing, Result):
        if thing.camera is None:
            raise OutputError(f"{folder}: the result has no camera: take that of an Initializer, or save its map")
        made_by = provenance_of(["Result.save"], {})
        summary = summary_of(thing, SourceRecord("python", "frames"), thing.camera, provenance=made_by)
        with OutputFolder(folder, "run") as out:
            publish_results(out, thing, summary)


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
    InitialMap.check(map_)
    names = [name.rpartition("/")[2] for name in COLMAP_FILES]
    with OutputFolder(folder, "colmap") as out:
        out.write(dict(zip(names, colmap_model(map_).texts(), strict=True)))
        out.publish()
