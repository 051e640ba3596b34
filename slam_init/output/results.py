"""The results of a run on disk.

A folder holds exactly one run::

    summary.json                the summary, as ``--json`` prints it
    trajectory.txt              TUM format: world_from_cam of the keyframes
    map.ply                     the landmarks with their colours, binary
    colmap/                     text model of the original images (cameras.txt, images.txt, points3D.txt)
    graph.txt, values.txt       factor graph and estimate as gtsam's text archives
    continued.txt               TUM format: world_from_cam of the frames that were located after the initialization
    config.toml                 the resolved configuration

Each file is first written under a temporary name. Only when all files are complete, they replace those of an earlier
run, the summary last. So a folder with a summary is complete, and a run that fails leaves the earlier results.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.errors import OutputError, SourceError
from slam_init.output.colmap import COLMAP_FILES, colmap_model, numbers_text
from slam_init.output.summary import Summary, summary_text
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.result import Result

__all__ = [
    "RECORDING",
    "load_graph",
    "ply_bytes",
    "prepare_folder",
    "remove_older_results",
    "tum_text",
    "write_results",
]

#: Name of the recording in the folder. :mod:`slam_init.recording.rerun_recorder` writes it during the run.
RECORDING = "recording.rrd"

_SUMMARY, _GRAPH, _VALUES = "summary.json", "graph.txt", "values.txt"
_FILES = (
    _SUMMARY,
    "trajectory.txt",
    "map.ply",
    *COLMAP_FILES,
    _GRAPH,
    _VALUES,
    "continued.txt",
    "config.toml",
)


def prepare_folder(out: Path) -> None:
    """Check before a run that results can be written to a folder. Files in the folder are not changed.

    Parameters
    ----------
    out : Path
        The folder; it is created with its parents if it does not exist.

    Raises
    ------
    OutputError
        If the path is a file, if the folder cannot be created or written, or if a folder has the name of a result.
    """
    try:
        if out.exists() and not out.is_dir():
            raise OutputError(f"--out {out} is a file: give a folder")
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass  # this only tests whether a file can be created
        for name in (*_FILES, RECORDING):
            path = out / name
            if path.is_dir():
                raise OutputError(f"{path} is a folder where a result belongs: give another --out")
            if path.parent.exists() and not path.parent.is_dir():
                raise OutputError(f"{path.parent} is a file where results belong: give another --out")
    except OSError as error:
        raise _output_error(out, error) from error


def remove_older_results(out: Path) -> None:
    """Remove results that are older than the recording beside them.

    An interrupted run has replaced the recording only; the other results are those of an earlier run.

    Parameters
    ----------
    out : Path
        Folder of the results.

    Raises
    ------
    OutputError
        If a file cannot be removed.
    """
    try:
        if (out / RECORDING).is_file():
            recorded = (out / RECORDING).stat().st_mtime_ns
            for path in (out / name for name in _FILES):
                if path.is_file() and path.stat().st_mtime_ns < recorded:
                    path.unlink()
    except OSError as error:
        raise _output_error(out, error) from error


def write_results(
    out: Path,
    result: Result,
    summary: Summary,
    config_toml: str | None = None,
    continued: Sequence[Keyframe] = (),
) -> None:
    """Write all results but the recording: either all files are replaced, or none.

    Files of an earlier run that this run does not write are removed.

    Parameters
    ----------
    out : Path
        The folder; it is created if it does not exist.
    result : Result
    summary : Summary
        From :func:`slam_init.output.summary.summary_of`.
    config_toml : str or None
        The resolved configuration.
    continued : sequence of Keyframe
        The frames that were located after the initialization.

    Raises
    ------
    OutputError
        If the path is a file, or a file cannot be written.
    """
    files = _contents(result, summary, config_toml, continued)
    if out.exists() and not out.is_dir():
        raise OutputError(f"--out {out} is a file: give a folder")
    temporaries: dict[str, Path] = {}
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            temporaries[name] = _write_beside(out / name, content)
        for name in (_SUMMARY, *_FILES):  # the summary is removed first and written last
            if name == _SUMMARY or name not in files:
                (out / name).unlink(missing_ok=True)
        for name, temporary in temporaries.items():
            temporary.replace(out / name)
    except OSError as error:
        raise _output_error(out, error) from error
    finally:  # after an interrupt as well: no temporary files are left
        for temporary in temporaries.values():
            temporary.unlink(missing_ok=True)


def _contents(
    result: Result, summary: Summary, config_toml: str | None, continued: Sequence[Keyframe]
) -> dict[str, bytes]:
    """Return the content of each file by name, the summary last."""
    files: dict[str, bytes] = {}
    if result.map is not None:
        files["trajectory.txt"] = tum_text(result.map.keyframes).encode()
        files["map.ply"] = ply_bytes(result.map)
        files |= {
            # The file system allows names of images that are not Unicode; the bytes are written unchanged.
            name: text.encode("utf-8", "surrogateescape")
            for name, text in zip(COLMAP_FILES, colmap_model(result.map), strict=True)
        }
        files[_GRAPH] = result.map.graph.serialize().encode()
        files[_VALUES] = result.map.values.serialize().encode()
    if continued:
        files["continued.txt"] = tum_text(continued).encode()
    if config_toml is not None:
        files["config.toml"] = config_toml.encode()
    files[_SUMMARY] = summary_text(summary).encode()
    return files


def load_graph(out: str | os.PathLike[str]) -> tuple[Any, Any]:
    """Read the factor graph of a run, to continue with it in gtsam.

    Parameters
    ----------
    out : str or path
        Folder of a run that initialized.

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
    import gtsam

    out = Path(out)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    try:
        graph.deserialize((out / _GRAPH).read_text())
        values.deserialize((out / _VALUES).read_text())
    except OSError as error:
        raise SourceError(f"no graph in {out}: give the --out folder of a run that initialized") from error
    except RuntimeError as error:  # gtsam cannot parse the archive
        raise SourceError(f"the graph in {out} is damaged: run again") from error
    return graph, values


def tum_text(keyframes: Sequence[Keyframe]) -> str:
    """Write a trajectory in TUM format.

    Parameters
    ----------
    keyframes : sequence of Keyframe

    Returns
    -------
    str
        One line ``timestamp tx ty tz qx qy qz qw`` for each keyframe: ``world_from_cam``, with w last.
    """
    lines = ["# timestamp tx ty tz qx qy qz qw (world_from_cam)"]
    for keyframe in keyframes:
        w, x, y, z = keyframe.world_from_cam.q_wxyz
        numbers = numbers_text([*keyframe.world_from_cam.t, x, y, z, w])
        lines.append(f"{keyframe.timestamp_s:.9f} {numbers}")
    return "\n".join(lines) + "\n"


def ply_bytes(map_: InitialMap) -> bytes:
    """Write the landmarks of a map in PLY format.

    Parameters
    ----------
    map_ : InitialMap

    Returns
    -------
    bytes
        Binary, little-endian; positions are float, colours are uchar.
    """
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        "comment world frame: the first keyframe's camera, x right, y down, z forward\n"
        f"element vertex {len(map_.points)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
        "end_header\n"
    )
    vertices = np.zeros(len(map_.points), dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
    vertices["xyz"], vertices["rgb"] = map_.points, map_.colors
    return header.encode() + vertices.tobytes()


def _write_beside(path: Path, content: bytes) -> Path:
    """Write a hidden file in the folder of the file that it will replace."""
    path.parent.mkdir(exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        # mkstemp makes private files; results get the usual permissions of the user's files.
        umask = os.umask(0)
        os.umask(umask)
        Path(temporary).chmod(0o666 & ~umask)
    except BaseException:  # an interrupt as well: no temporary file is left
        Path(temporary).unlink(missing_ok=True)
        raise
    return Path(temporary)


def _output_error(out: Path, error: OSError) -> OutputError:
    return OutputError(f"cannot write to --out {out}: {error.strerror or error}: give a folder that you can write to")
