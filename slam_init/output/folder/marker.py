"""The marker of an output folder: which command wrote it, and which files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from slam_init.errors import OutputError
from slam_init.output.folder.files import is_safe_name, replace_synced

#: The hidden folder of the program in an output folder.
HOME = ".slam-init"
#: The name of the marker in it.
MARKER = "files.json"
_SCHEMA = 1
#: A marker of a comparison with 100,000 recordings has 10 MB.
_MAX_BYTES = 1 << 26


@dataclass(frozen=True)
class Marker:
    """What the program wrote to a folder."""

    #: ``run``, ``compare`` or ``synth``.
    command: str
    #: Version of the program.
    version: str
    #: Relative paths with slashes. A file on the list need not exist.
    files: frozenset[str]

    @classmethod
    def make(cls, command: str, files: frozenset[str] = frozenset()) -> Marker:
        """Make a marker of this version."""
        try:
            return cls(command, version("slam-init"), files)
        except PackageNotFoundError:  # run from a checkout
            return cls(command, "unknown", files)


def read_marker(out: Path) -> Marker | None:
    """Read the marker of a folder."""
    path = out / HOME / MARKER
    if (out / HOME).is_symlink() or not path.is_file():
        return None
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ValueError("too large")
        content = json.loads(path.read_bytes())
        files = content["files"]
        if content["schema"] != _SCHEMA or not all(is_safe_name(name, HOME) for name in files):
            raise ValueError("not of this program")
        return Marker(str(content["command"]), str(content["version"]), frozenset(files))
    except (ValueError, KeyError, TypeError, RecursionError):
        raise OutputError(f"{path} is damaged: remove {out}, or give another --out") from None


def write_marker(out: Path, marker: Marker) -> None:
    """Write the marker of a folder."""
    content = {"schema": _SCHEMA, "command": marker.command, "version": marker.version, "files": sorted(marker.files)}
    replace_synced(out / HOME / MARKER, json.dumps(content, indent=1).encode() + b"\n")
