"""The messages between a worker of a backend and the process in which its trials run.

:mod:`slam_init.compare.isolation` sends the requests, and :mod:`slam_init.compare.worker` answers them. Requests are
pickled. Answers come from a process in which a method of somebody else may have run: they are one line of JSON each,
and every value is checked.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

from slam_init.compare.rows import TrialRow, finite_json, parse_row, row_text
from slam_init.compare.trials import Settings, Trial

#: Sent by the process when it has loaded its libraries, before the first request.
READY = b"ready\n"
#: Longest text of an error in characters.
_MAX_TEXT = 2000


@dataclass(frozen=True)
class TrialRequest:
    """Run a trial."""

    trial: Trial
    settings: Settings


@dataclass(frozen=True)
class TracksRequest:
    """Compute and store the tracks of a source."""

    #: Argument of :func:`slam_init.compare.sources.open_compared`.
    text: str
    #: With the folder of the tracks.
    settings: Settings


@dataclass(frozen=True)
class MethodRequest:
    """Import and make a method."""

    #: ``package.module:attribute``.
    name: str


@dataclass(frozen=True)
class Answer:
    """The answer to a request."""

    #: Name of the class of the request.
    request: str
    #: Why a file of a trial cannot be written, a source cannot be read to its end, or a method cannot be made.
    error: str | None = None
    #: The row of a trial. If a file of the trial could not be written, the row says nothing about the method.
    row: TrialRow | None = None
    #: Whether an allocation of a trial failed. The state of the libraries in the process is unknown then.
    memory_exhausted: bool = False
    #: :func:`slam_init.compare.replay.tracks_digest` of the tracks.
    digest: str = ""

    def line(self) -> bytes:
        """Write the answer as one line. A row with a number that is not finite is a ValueError."""
        row = None if self.row is None else json.loads(row_text(self.row))
        return json.dumps(vars(self) | {"row": row}, allow_nan=False).encode() + b"\n"


Request = TrialRequest | TracksRequest | MethodRequest


def parse_answer(line: bytes) -> Answer:
    """Read an answer, and check each of its values."""
    content = finite_json(line)
    exhausted, row = content.get("memory_exhausted"), content.get("row")
    if not isinstance(exhausted, bool):
        raise ValueError("memory_exhausted is no truth value")
    return Answer(
        _text(content.get("request")) or "",
        _text(content.get("error")),
        None if row is None else parse_row(json.dumps(row)),
        exhausted,
        _text(content.get("digest")) or "",
    )


def _text(value: object) -> str | None:
    if value is not None and not isinstance(value, str):
        raise ValueError("not a text")
    return None if value is None else " ".join(value.split())[:_MAX_TEXT]
