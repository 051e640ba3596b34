"""Whether a command may write to a folder. Nothing is written."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from slam_init.errors import OutputError
from slam_init.output.folder.marker import HOME, Marker, output_error, pending, read_marker, under
from slam_init.output.names import COLMAP_FILES, COMPARE_FILES, RECORDING
from slam_init.system.regular_file import user_path

#: A folder that holds these only counts as empty: file systems and file managers create them.
_NO_CONTENT = {HOME, "lost+found", ".DS_Store"}


def chosen_folder(
    text: str, command: str, targets: Collection[str] = (), inputs: Iterable[str | os.PathLike[str]] = ()
) -> Path:
    """Return the folder of the option ``--out``.

    A place that the command cannot or must not write to is refused before any work. Nothing is created.
    """
    if not text:
        raise OutputError("--out is empty: give a folder")
    out = user_path(text)
    try:
        str(out).encode()
        if out.exists() and not out.is_dir():
            raise OutputError(f"--out {out} is a file: give a folder")
        if not out.exists() and out.suffix.lower() in {Path(name).suffix for name in targets} - {""}:
            raise OutputError(f"--out {out} names a file: give a folder, as in {out.with_suffix('').name or 'results'}")
        existing = next(parent for parent in (out, *out.resolve().parents) if parent.exists())
    except UnicodeEncodeError:
        raise OutputError(f"--out {str(out)!r}: bytes that are no UTF-8 cannot name a recording: rename it") from None
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: links in a circle
        raise OutputError(f"--out {str(out)!r} cannot be used ({error})") from None
    if not existing.is_dir():
        raise OutputError(f"--out {out}: {existing} is a file, not a folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(f"--out {out}: no permission to write in {existing}")
    check_folder(out, command, targets, inputs)
    return out


def check_folder(
    out: str | os.PathLike[str],
    command: str,
    targets: Collection[str] = (),
    inputs: Iterable[str | os.PathLike[str]] = (),
) -> Marker:
    """Refuse a folder that a command must not write to.

    * ``inputs``: Files and folders that the command reads. A name that is no path is ignored.
    """
    out = Path(out)
    try:
        marker = _marker_of(out, command)
        if marker.command != command:
            raise OutputError(f"--out {out} holds results of slam-init {marker.command}: give another --out")
        refuse_foreign_files(out, marker, targets)
        _refuse_inputs(out, {*marker.files, *targets}, inputs)
    except OSError as error:
        raise output_error(out, error) from error
    return marker


def refuse_foreign_files(out: Path, marker: Marker, targets: Collection[str]) -> None:
    """Refuse to write where a file lies that the program did not write."""
    for name in sorted({*targets, *marker.files}):
        path = under(out, name)
        if path.is_dir() and not path.is_symlink():
            raise OutputError(f"{path} is a folder where a result belongs: remove it, or give another --out")
        if name not in marker.files and os.path.lexists(path):
            raise OutputError(f"{path} is not a file that slam-init wrote: move it, or give another --out")


def _marker_of(out: Path, command: str) -> Marker:
    """Return the marker of the folder; an empty one for a new or empty folder."""
    if not os.path.lexists(out):
        return Marker.make(command)
    if not out.is_dir():
        raise OutputError(f"--out {out} is a file: give a folder")
    home = out / HOME
    if home.is_symlink() or (home.exists() and not home.is_dir()):
        raise OutputError(f"{home} is not a folder of slam-init: remove it, or give another --out")
    marker = read_marker(out) or legacy_marker(out)
    if marker is not None:
        # Some files of a step that a killed command began are in their places already.
        step = pending(out)
        return marker if step is None else replace(marker, files=marker.files | set(step.put))
    with os.scandir(out) as entries:
        found = next((entry.name for entry in entries if entry.name not in _NO_CONTENT), None)
    if found is not None:
        raise OutputError(
            f"--out {out} is not empty, and slam-init did not write it (it holds {found!r}): "
            "give a new or an empty folder"
        )
    return Marker.make(command)


def _refuse_inputs(out: Path, names: Collection[str], inputs: Iterable[str | os.PathLike[str]]) -> None:
    """Refuse to replace a file that the command reads, or to write into the folder of its data."""
    places = {out, *((out / name).parent for name in names)}
    for given in inputs:
        path = user_path(given)
        # os.path: False, not an error, for names that no file can have.
        if os.path.isdir(path):  # noqa: PTH112
            if any(_same(path, place) for place in places):
                raise OutputError(f"--out {out} is the folder of the data: give another one")
        elif os.path.isfile(path) and any(_same(path, out / name) for name in names):  # noqa: PTH113
            raise OutputError(
                f"--out {out}: results would replace {path}, which is read: copy it, or give another --out"
            )


def _same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other) or path.resolve() == other.resolve()
    except (OSError, ValueError):  # one of them does not exist
        return path.resolve() == other.resolve()


_VERSION = "0.1"
#: The keys that the summary of each command had, and the files that the command wrote.
_RUN_KEYS = {"schema", "method", "seed", "camera", "attempts", "frames_read"}
_RUN_FILES = (
    *("trajectory.txt", "map.ply", "graph.txt", "values.txt", "continued.txt", "config.toml", "summary.json"),
    *COLMAP_FILES,
    *(RECORDING, "recording.partial.rrd", "interrupted.rrd"),
)
_COMPARE_KEYS = {"schema", "seed", "trials", "methods", "sources", "parts"}
_JOURNAL_KEYS = {"schema", "seed", "limit_frames", "options"}
_RECORDINGS = "recordings/*/*.rrd"
#: A summary has less than 1 MB; the first line of a journal has less than 10 kB.
_MAX_BYTES, _MAX_LINE = 1 << 26, 1 << 20


def legacy_marker(out: Path) -> Marker | None:
    """Return the marker that version 0.1 would have written."""
    summary, journal = out / "summary.json", out / "trials.jsonl"
    keys: set[str] = set()
    if summary.is_file() and summary.stat().st_size <= _MAX_BYTES:
        keys = _keys(summary.read_bytes())
    if keys >= _RUN_KEYS:
        return Marker("run", _VERSION, frozenset(name for name in _RUN_FILES if (out / name).is_file()))
    if not keys and journal.is_file():  # an unfinished comparison has no summary
        with journal.open("rb") as file:
            if _keys(file.readline(_MAX_LINE)) >= _JOURNAL_KEYS:
                keys = _COMPARE_KEYS
    if keys >= _COMPARE_KEYS:
        recordings = (path.relative_to(out).as_posix() for path in out.glob(_RECORDINGS) if path.is_file())
        files = (name for name in COMPARE_FILES if (out / name).is_file())
        return Marker("compare", _VERSION, frozenset((*files, *recordings)))
    return None


def _keys(text: bytes) -> set[str]:
    """Return the keys of a JSON object; none of another text."""
    try:
        content: Any = json.loads(text)
    except (ValueError, RecursionError):
        return set()
    return set(content) if isinstance(content, dict) else set()
