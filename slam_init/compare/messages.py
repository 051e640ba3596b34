"""The messages between a worker of a backend and the process in which its trials run.

:mod:`slam_init.compare.isolation` sends the requests, and :mod:`slam_init.compare.worker` answers them. Requests are
pickled. Answers come from a process in which a method of somebody else may have run: they are one line of JSON each,
and every value is checked.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TypeAlias

from slam_init.compare.rows import TrialRow, finite_json, parse_row, row_text
from slam_init.compare.trials import Settings, Trial

#: Sent by the process when it has loaded its libraries, before the first request.
READY = b"ready\n"
#: Longest text of an error in characters.
_MAX_TEXT = 2000


@dataclass(frozen=True)
class TrialRequest:
    """Run a trial; the answer is a :class:`TrialAnswer`."""

    trial: Trial
    settings: Settings


@dataclass(frozen=True)
class TrialAnswer:
    """The result of a trial."""

    #: With ``peak_memory_mb``.
    row: TrialRow
    #: Whether an allocation failed. The state of the libraries in the process is unknown then.
    memory_exhausted: bool
    #: Why a file of the trial could not be written; None if all were. The row then tells nothing about the method.
    output_error: str | None = None


@dataclass(frozen=True)
class TracksRequest:
    """Compute and store the tracks of a source; the answer is a :class:`TracksAnswer`."""

    #: Argument of :func:`slam_init.compare.sources.open_compared`.
    text: str
    #: With the folder of the tracks.
    settings: Settings


@dataclass(frozen=True)
class TracksAnswer:
    """The tracks of a source are stored, or the source cannot be read."""

    #: Why the source cannot be read to its end; None if the tracks are stored.
    error: str | None
    #: Time until the tracks were stored, or until the error, in milliseconds.
    tracking_ms: float
    #: :func:`slam_init.compare.replay.tracks_digest` of the tracks; empty for an error.
    digest: str = ""


@dataclass(frozen=True)
class MethodRequest:
    """Import and make a method; the answer is a :class:`MethodAnswer`."""

    #: ``package.module:attribute``.
    name: str


@dataclass(frozen=True)
class MethodAnswer:
    """Whether there is such a method."""

    #: Why there is none; None if there is one.
    error: str | None


Request: TypeAlias = TrialRequest | TracksRequest | MethodRequest
Answer: TypeAlias = TrialAnswer | TracksAnswer | MethodAnswer


def answer_line(answer: Answer) -> bytes:
    """Write an answer as one line."""
    if isinstance(answer, TrialAnswer):
        content = {
            "row": json.loads(row_text(answer.row)),
            "memory_exhausted": answer.memory_exhausted,
            "output_error": answer.output_error,
        }
    else:
        content = asdict(answer)
    return json.dumps({"answer": type(answer).__name__, **content}, allow_nan=False).encode() + b"\n"


def parse_answer(line: bytes) -> Answer:
    """Read an answer, and check each of its values."""
    content = finite_json(line)
    kind = content.get("answer")
    if kind == "TrialAnswer":
        exhausted = content.get("memory_exhausted")
        if not isinstance(exhausted, bool):
            raise ValueError("memory_exhausted is no truth value")
        return TrialAnswer(parse_row(json.dumps(content.get("row"))), exhausted, _text(content.get("output_error")))
    if kind == "TracksAnswer":
        duration = content.get("tracking_ms")
        if not isinstance(duration, float | int):
            raise ValueError("tracking_ms is no number")
        return TracksAnswer(_text(content.get("error")), float(duration), _text(content.get("digest")) or "")
    if kind == "MethodAnswer":
        return MethodAnswer(_text(content.get("error")))
    raise ValueError("not an answer")


def _text(value: object) -> str | None:
    if value is not None and not isinstance(value, str):
        raise ValueError("not a text")
    return None if value is None else " ".join(value.split())[:_MAX_TEXT]
