"""What an initializer hands over, whatever its method: refusals with a reason, the map, the reason of a whole run."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from slam_init.config import MapConfig
from slam_init.types.initial_map import InitialMap
from slam_init.types.reasons import ACCEPTED, ADVICE, REASONS
from slam_init.types.result import Attempt

__all__ = ["ATTEMPTS_KEPT", "AttemptLog", "focal_notes", "reported_focal_factor"]

_VERDICTS = (*REASONS, ACCEPTED)


#: Attempts that are remembered in full: half a minute of video, and all that a recording of that length shows. What is
#: remembered must not grow with the length of the video.
ATTEMPTS_KEPT = 1000

#: A single pair may look like a turning camera by chance. The check finds the factor of one that turns to a hundredth.
_LEAST_SUSPICIONS, _ALIKE = 2, 0.015


class AttemptLog:
    """The attempts of a run: the last ones without their matches, of all of them the verdict in one byte.

    Parameters
    ----------
    limit : int
        How many are kept.
    """

    def __init__(self, limit: int = ATTEMPTS_KEPT) -> None:
        self._kept: deque[Attempt] = deque(maxlen=limit)
        self._verdicts = bytearray()

    def __len__(self) -> int:
        return len(self._verdicts)

    def add(self, attempt: Attempt) -> None:
        """Remember an attempt."""
        none = np.zeros((0, 2))
        self._kept.append(replace(attempt, pixels1=none, pixels2=none, inliers=np.zeros(0, bool)))
        self._verdicts.append(_VERDICTS.index(attempt.verdict))

    @property
    def kept(self) -> tuple[Attempt, ...]:
        """The last attempts."""
        return tuple(self._kept)

    def prevailing_reason(self) -> str:
        """What the second half of the attempts mostly said; the slow start of a video says little."""
        if not self._verdicts:
            return "too_few_frames"
        counts = Counter(self._verdicts[len(self._verdicts) // 2 :])
        return _VERDICTS[min(counts, key=lambda verdict: (-counts[verdict], verdict))]

    def advice(self, reason: str) -> str:
        """What would help: that of the last attempt that was refused for the reason."""
        return next((a.advice for a in reversed(self._kept) if a.verdict == reason), ADVICE[reason])

    def notes(self) -> tuple[str, ...]:
        """What the user should know: a calibration that most checks suspect, attempts that are not kept."""
        notes = []
        factor = reported_focal_factor(self._kept)
        if factor is not None:
            notes.append(
                f"the matches look like those of a camera that only turned, with a focal length {factor:.2f} times the "
                "stated one: check the calibration"
            )
        if len(self) > len(self._kept):
            notes.append(f"{len(self)} attempts were made; the last {len(self._kept)} are listed")
        return tuple(notes)


def reported_focal_factor(attempts: Iterable[Attempt]) -> float | None:
    """What most checks of the calibration suspect, two at least, and alike: a wrong one is so in every pair.

    Parameters
    ----------
    attempts : iterable of Attempt
        Of a run.

    Returns
    -------
    float or None
        The focal length over the stated one; None where nothing is suspected.
    """
    checked = [a.evidence for a in attempts if "turning_focal_factor" in a.evidence]
    factors = [float(e["suspected_focal_factor"]) for e in checked if "suspected_focal_factor" in e]
    if len(factors) < _LEAST_SUSPICIONS or 2 * len(factors) <= len(checked):
        return None
    factor = float(np.median(factors))
    first, second = np.triu_indices(len(factors), 1)
    alike = np.median(np.abs(np.array(factors)[first] - np.array(factors)[second])) < _ALIKE
    return factor if alike else None


def focal_notes(map_: InitialMap | None, config: MapConfig) -> tuple[str, ...]:
    """What the user should know of an adjusted focal length: that the views did not tell it, where that is so.

    Parameters
    ----------
    map_ : InitialMap or None
    config : MapConfig
        That the map was adjusted with.
    """
    if map_ is None or map_.focal_factor_sigma is None:
        return ()
    # Below this the views know more of it than the prior: two equal variances together are half of one.
    if map_.focal_factor_sigma < config.focal_sigma / np.sqrt(2):
        return ()
    return (
        f"the views do not tell the focal length: {map_.focal_factor:.3f} +- {map_.focal_factor_sigma:.3f} times the "
        f"stated one is little more than the assumption of +- {config.focal_sigma:.3g}; turn the camera while it moves",
    )
