"""The messages between a worker of a backend and the process in which its trials run.

:mod:`slam_init.compare.isolation` sends the requests, and :mod:`slam_init.compare.worker` answers them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from slam_init.compare.rows import TrialRow
from slam_init.compare.trials import Settings, Trial

__all__ = ["READY", "Answer", "Request", "TracksAnswer", "TracksRequest", "TrialAnswer", "TrialRequest"]

#: Sent by the process when it has loaded its libraries, before the first request.
READY = "ready"


@dataclass(frozen=True)
class TrialRequest:
    """Run a trial; the answer is a :class:`TrialAnswer`.

    Attributes
    ----------
    trial : Trial
    settings : Settings
    """

    trial: Trial
    settings: Settings


@dataclass(frozen=True)
class TrialAnswer:
    """The result of a trial.

    Attributes
    ----------
    row : TrialRow
        With ``peak_memory_mb``.
    memory_exhausted : bool
        Whether an allocation failed. The state of the libraries in the process is unknown then.
    """

    row: TrialRow
    memory_exhausted: bool


@dataclass(frozen=True)
class TracksRequest:
    """Compute and store the tracks of a source; the answer is a :class:`TracksAnswer`.

    Attributes
    ----------
    text : str
        Argument of :func:`slam_init.compare.sources.open_compared`.
    settings : Settings
        With the folder of the tracks.
    """

    text: str
    settings: Settings


@dataclass(frozen=True)
class TracksAnswer:
    """The tracks of a source are stored, or the source cannot be read.

    Attributes
    ----------
    error : str or None
        Why the source cannot be read to its end; None if the tracks are stored.
    tracking_ms : float
        Time until the tracks were stored, or until the error, in milliseconds.
    """

    error: str | None
    tracking_ms: float


Request: TypeAlias = TrialRequest | TracksRequest
Answer: TypeAlias = TrialAnswer | TracksAnswer
