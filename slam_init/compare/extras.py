"""What a benchmark adds to a comparison: files of its own, the digests of the tracks, trajectories."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from slam_init.compare.plan import Plan
from slam_init.compare.trial_table import TrialTable
from slam_init.errors import OutputError

#: Digest of the tracks by the label of the source.
Digests: TypeAlias = Mapping[str, str]
MakeTexts: TypeAlias = Callable[[TrialTable, Plan, Digests], Mapping[str, str]]


def _no_texts(table: TrialTable, plan: Plan, digests: Digests) -> Mapping[str, str]:
    """Return no further files."""
    return {}


@dataclass(frozen=True)
class Extras:
    """The additions of a benchmark."""

    #: The command that the folder of the results belongs to.
    command: str = "compare"
    #: Names of the further files.
    files: tuple[str, ...] = ()
    #: File of the digests of the tracks; empty for none.
    digests: str = ""
    #: Whether the trials write their trajectories.
    trajectories: bool = False
    #: Takes the trials, the plan and the digests, and returns the content of further files by name.
    texts: MakeTexts = _no_texts


class StoredDigests:
    """The digests of the tracks, on disk: a comparison that is resumed does not compute the tracks of finished trials.

    * ``path``: None keeps them in memory only.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.known: dict[str, str] = {}
        if path is not None and path.is_file():
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    label, digest = json.loads(line)
                except (ValueError, TypeError):  # the process was killed while it wrote this line
                    continue
                self.known[str(label)] = str(digest)

    def add(self, label: str, digest: str) -> None:
        """Add the digest of a source."""
        if self.known.get(label) == digest:
            return
        self.known[label] = digest
        if self._path is None:
            return
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps([label, digest]) + "\n")
        except OSError as error:
            raise OutputError(f"cannot write {self._path}: {error.strerror}: make room") from error
