"""Tells what a folder of results holds, from its files alone.

The folder may come from somebody else: it is read within bounds, and a file that is not what it should be is an error
of one line.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from slam_init.errors import SourceError, plain_line
from slam_init.output.folder import read_marker
from slam_init.output.names import RECORDING, RUN_FILES
from slam_init.system.regular_file import check_inside, read_regular
from slam_init.types.result import why_no_map

_SUMMARY = "summary.json"
#: A thousand attempts with their gates and evidence have 4 MB.
_LIMIT_BYTES = 64_000_000
#: More keyframes are cut in the text, never in the facts.
_SHOWN_KEYFRAMES = 20


@dataclass(frozen=True)
class _Keyframe:
    frame: int


@dataclass(frozen=True)
class _Window:
    risk: float | None = None


@dataclass(frozen=True)
class _Attempt:
    window: _Window | None = None


@dataclass(frozen=True)
class _Source:
    name: str = ""


@dataclass(frozen=True)
class _Provenance:
    packages: Mapping[str, str] = field(default_factory=dict)
    command: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Summary:
    """What is read of ``summary.json``. Versions before this one may lack the keys that have a default."""

    status: str
    method: str
    seed: int
    frames_read: int
    landmarks: int
    frames_to_init: int | None
    reason: str | None = None
    advice: str = ""
    source: _Source = _Source()
    keyframes: tuple[_Keyframe, ...] = ()
    hypotheses: tuple[object, ...] = ()
    attempts: tuple[_Attempt, ...] = ()
    provenance: _Provenance | None = None
    notes: tuple[str, ...] = ()
    wrong_focal: Mapping[str, object] | None = None


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


@dataclass(frozen=True)
class ResultFolder:
    """A folder of results that was read.

    * ``files``: The size of each file of the run that is there, by its relative path with slashes.
    """

    path: str
    summary: _Summary
    files: Mapping[str, int]

    @staticmethod
    def read(path: str | os.PathLike[str]) -> ResultFolder:
        """Read a folder of results."""
        folder = Path(path)
        there = (name for name in RUN_FILES if (folder / name).is_file() and not (folder / name).is_symlink())
        return ResultFolder(
            str(folder), _read_summary(folder), {name: (folder / name).stat().st_size for name in there}
        )

    def facts(self) -> dict[str, object]:
        """Return the facts in the order of ``slam-init info --json``. The risk is that of the last judged window."""
        summary, provenance = self.summary, self.summary.provenance or _Provenance()
        return {
            "folder": self.path,
            "status": summary.status,
            "reason": summary.reason,
            "advice": summary.advice,
            "risk": self._risk,
            "source": summary.source.name,
            "method": summary.method,
            "seed": summary.seed,
            "frames_read": summary.frames_read,
            "frames_to_init": summary.frames_to_init,
            "keyframes": [one.frame for one in summary.keyframes],
            "landmarks": summary.landmarks,
            "hypotheses": len(summary.hypotheses),
            "attempts": len(summary.attempts),
            "files": [{"name": name, "bytes": size} for name, size in self.files.items()],
            "version": provenance.packages.get("slam-init"),
            "command": provenance.command,
            "notes": summary.notes,
        }

    def text(self) -> str:
        """Format the facts for people, one per line."""
        summary, provenance = self.summary, self.summary.provenance or _Provenance()
        if summary.reason is None:
            title, count = f"initialized after {summary.frames_to_init} frames", len(summary.keyframes)
            frames = ", ".join(str(one.frame) for one in summary.keyframes[:_SHOWN_KEYFRAMES])
            more = ", ..." if count > _SHOWN_KEYFRAMES else ""
            facts = [("keyframes", f"{count} (frames {frames}{more})"), ("landmarks", str(summary.landmarks))]
        else:
            title = (
                f"not initialized after {summary.frames_read} frames: {why_no_map(summary.reason, summary.wrong_focal)}"
            )
            facts = [("advice", summary.advice)]
            if summary.hypotheses:
                facts.append(("kept", f"{len(summary.hypotheses)} maps, one of them is right"))
        if self._risk is not None:
            facts.append(("risk", f"{self._risk:.2g} that the map is wrong"))
        sizes = [f"{name}  {_size(size)}" for name, size in self.files.items()]
        facts += [
            ("source", summary.source.name),
            ("method", f"{summary.method}, seed {summary.seed}, {len(summary.attempts)} attempts"),
            ("version", provenance.packages.get("slam-init", "unknown")),
            ("command", " ".join(provenance.command) or "unknown"),
            *(("note", note) for note in summary.notes),
            *(("" if k else "files", size) for k, size in enumerate(sizes)),
        ]
        lines = [f"{self.path}: {title}", *(f"  {name:<12}{text}" for name, text in facts)]
        return "\n".join(plain_line(line) for line in lines) + "\n"

    @property
    def _risk(self) -> float | None:
        windows = [attempt.window for attempt in self.summary.attempts if attempt.window is not None]
        risk = windows[-1].risk if windows else None
        return risk if risk is not None and math.isfinite(risk) else None


def _read_summary(folder: Path) -> _Summary:
    path = folder / _SUMMARY
    check_inside(path, folder)
    if not path.exists():
        raise SourceError(f"{folder} holds no {_SUMMARY}: the run was interrupted, or is not complete; run again")
    data = read_regular(path, _LIMIT_BYTES, "the summary of a run", SourceError)
    try:
        return TypeAdapter(_Summary).validate_json(data, strict=True)
    except ValidationError as error:
        where = ".".join(map(str, error.errors()[0]["loc"]))
        raise SourceError(f"{path} is damaged{f' at {where}' if where else ''}: run again") from None


def _size(count: int) -> str:
    for unit, scale in (("MB", 1_000_000), ("kB", 1000)):
        if count >= scale:
            return f"{count / scale:.1f} {unit}"
    return f"{count} bytes"
