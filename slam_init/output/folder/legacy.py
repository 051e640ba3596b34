"""Folders of version 0.1, which had no marker: their ``summary.json`` or ``trials.jsonl`` tells the command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from slam_init.output.folder.marker import Marker
from slam_init.output.names import COLMAP_FILES, COMPARE_FILES, RECORDING

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
