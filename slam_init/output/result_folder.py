"""Tells what a folder of results holds, from its files alone.

The folder may come from somebody else: it is read within bounds, and a file that is not what it should be is an error
of one line.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from slam_init.errors import SourceError, plain_line
from slam_init.output.folder import read_marker
from slam_init.output.names import RECORDING, RUN_FILES
from slam_init.system.regular_file import check_inside, read_regular
from slam_init.types.reasons import in_words

_SUMMARY = "summary.json"
#: A thousand attempts with their gates and evidence have 4 MB.
_LIMIT_BYTES = 64_000_000
#: More keyframes and longer texts are cut in the text, never in the description.
_SHOWN_KEYFRAMES = 20

_Kind = TypeVar("_Kind")


@dataclass(frozen=True)
class FileSize:
    """A file of the results."""

    #: Relative path with slashes.
    name: str
    bytes: int


@dataclass(frozen=True)
class ResultDescription:
    """The facts about a folder of results, in the order of the output of ``slam-init info --json``."""

    folder: str
    #: ``initialized`` or ``not_initialized``.
    status: str
    #: Why there is no map.
    reason: str | None
    advice: str
    #: Risk of the last window, where one was judged.
    risk: float | None
    #: Name of the source.
    source: str
    method: str
    seed: int
    frames_read: int
    frames_to_init: int | None
    #: Absolute indices of the keyframes.
    keyframes: tuple[int, ...]
    landmarks: int
    #: Number of maps that the views did not decide between: 0 or 2.
    hypotheses: int
    attempts: int
    #: The files of a run that are there.
    files: tuple[FileSize, ...]
    #: Version of slam-init that made the results, where they tell it.
    version: str | None
    #: Its command line; empty where the results do not tell it.
    command: tuple[str, ...]
    notes: tuple[str, ...]


def is_result_folder(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is a folder that ``slam-init run`` wrote, or a copy of one.

    * Returns: True for a folder with the marker of a run. A copy may lack the marker: then there are a summary, and the
      resolved configuration or the recording beside it.
    """
    folder = Path(path)
    try:
        if not folder.is_dir():
            return False
        marker = read_marker(folder)
        if marker is not None:
            return marker.command == "run"
        others = ("config.toml", RECORDING)
        return (folder / _SUMMARY).is_file() and any((folder / name).is_file() for name in others)
    except Exception:  # a name that the system does not take, or a damaged marker: the readers tell
        return False


def describe_result(path: str | os.PathLike[str]) -> ResultDescription:
    """Describe a folder of results."""
    folder = Path(path)
    get = _Fields(folder / _SUMMARY, _read_summary(folder))
    provenance = get.below("provenance")
    version = provenance.get("packages", dict, {}).get("slam-init")
    keyframes = [_Fields(folder / _SUMMARY, one) for one in get.each("keyframes", dict)]
    attempts = [_Fields(folder / _SUMMARY, one) for one in get.each("attempts", dict)]
    reason = get.get("reason", str, "") or None
    return ResultDescription(
        folder=str(folder),
        status=get.get("status", str),
        reason=reason,
        advice=get.get("advice", str, ""),
        risk=_last_risk(attempts),
        source=get.below("source").get("name", str, ""),
        method=get.get("method", str),
        seed=get.get("seed", int),
        frames_read=get.get("frames_read", int),
        frames_to_init=get.get("frames_to_init", int) if reason is None else None,
        keyframes=tuple(one.get("frame", int) for one in keyframes),
        landmarks=get.get("landmarks", int),
        hypotheses=len(get.each("hypotheses", dict)),
        attempts=len(attempts),
        files=_sizes(folder),
        version=version if isinstance(version, str) else None,
        command=tuple(provenance.each("command", str)),
        notes=tuple(get.each("notes", str)),
    )


def describe_result_text(info: ResultDescription) -> str:
    """Format a description for people, one fact per line."""
    if info.reason is None:
        title = f"initialized after {info.frames_to_init} frames"
        frames = ", ".join(map(str, info.keyframes[:_SHOWN_KEYFRAMES]))
        more = ", ..." if len(info.keyframes) > _SHOWN_KEYFRAMES else ""
        facts = [("keyframes", f"{len(info.keyframes)} (frames {frames}{more})"), ("landmarks", str(info.landmarks))]
    else:
        title = f"not initialized after {info.frames_read} frames: {in_words(info.reason)}"
        facts = [("advice", info.advice)]
        if info.hypotheses:
            facts.append(("kept", f"{info.hypotheses} maps, one of them is right"))
    if info.risk is not None:
        facts.append(("risk", f"{info.risk:.2g} that the map is wrong"))
    facts += [
        ("source", info.source),
        ("method", f"{info.method}, seed {info.seed}, {info.attempts} attempts"),
        ("version", info.version or "unknown"),
        ("command", " ".join(info.command) or "unknown"),
        *(("note", note) for note in info.notes),
        *((f"{'files' if k == 0 else ''}", f"{one.name}  {_size(one.bytes)}") for k, one in enumerate(info.files)),
    ]
    lines = [f"{info.folder}: {title}", *(f"  {name:<12}{text}" for name, text in facts)]
    return "\n".join(plain_line(line) for line in lines) + "\n"


class _Fields:
    """Reads the fields of a table of JSON, and tells which one is not what it should be."""

    def __init__(self, path: Path, table: Mapping[str, object]) -> None:
        self._path, self._table = path, table

    def get(self, key: str, kind: type[_Kind], missing: _Kind | None = None) -> _Kind:
        """Return a value of a kind; ``missing`` for null or no value, unless that is None."""
        value = self._table.get(key)
        if value is None and missing is not None:
            return missing
        if not isinstance(value, kind) or isinstance(value, bool):
            raise self._damaged(key)
        return value

    def each(self, key: str, kind: type[_Kind]) -> list[_Kind]:
        """Return a list of values of a kind; an empty one if there is none."""
        values = self.get(key, list, [])
        if not all(isinstance(value, kind) for value in values):
            raise self._damaged(key)
        return values

    def below(self, key: str) -> _Fields:
        """Return a table in this table; an empty one if there is none."""
        return _Fields(self._path, self.get(key, dict, {}))

    def _damaged(self, key: str) -> SourceError:
        return SourceError(f"{self._path}: {key} is missing or is not what a run writes: run again")


def _read_summary(folder: Path) -> Mapping[str, object]:
    path = folder / _SUMMARY
    check_inside(path, folder)
    if not path.exists():
        raise SourceError(f"{folder} holds no {_SUMMARY}: the run was interrupted, or is not complete; run again")
    data = read_regular(path, _LIMIT_BYTES, "the summary of a run", SourceError)
    try:
        summary = json.loads(data)
    except (ValueError, RecursionError):
        raise SourceError(f"{path}: is damaged: run again") from None
    if not isinstance(summary, dict):
        raise SourceError(f"{path}: is not the summary of a run")
    return summary


def _last_risk(attempts: list[_Fields]) -> float | None:
    for attempt in reversed(attempts):
        if window := attempt.get("window", dict, {}):
            risk = window.get("risk")
            return float(risk) if isinstance(risk, int | float) and math.isfinite(risk) else None
    return None


def _sizes(folder: Path) -> tuple[FileSize, ...]:
    sizes = []
    for name in RUN_FILES:
        path = folder / name
        try:
            if path.is_file() and not path.is_symlink():
                sizes.append(FileSize(name, path.stat().st_size))
        except OSError:  # the file has gone, or its folder cannot be read
            continue
    return tuple(sizes)


def _size(count: int) -> str:
    for unit, scale in (("MB", 1_000_000), ("kB", 1000)):
        if count >= scale:
            return f"{count / scale:.1f} {unit}"
    return f"{count} bytes"
