"""The attempts of a run: the last ones in full, the reason of the whole run, and the notes for the user."""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from slam_init.config import MapConfig
from slam_init.types.gates import Stage
from slam_init.types.initial_map import InitialMap
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt

_LOG = logging.getLogger("slam_init")
_LOG.addHandler(logging.NullHandler())
_VERDICTS = tuple(Verdict)

#: Number of attempts that are kept in full, enough for half a minute of video. The memory of an initializer must not
#: grow with the length of the video.
#: Class: budget.
ATTEMPTS_KEPT = 1000

#: A single pair may look like a rotation-only camera by chance, so at least two suspicions are required. The focal
#: factors of a camera that really only rotates agree to a hundredth.
#: Class: assumption.
_LEAST_SUSPICIONS, _ALIKE = 2, 0.015


class AttemptLog:
    """The last attempts without their matches, the verdicts of all attempts (one byte each), and the best progress.

    Each attempt is also written to the logger ``slam_init``: at level INFO if it was accepted, or refused by the
    estimate of two views or by its window, and at level DEBUG if it was refused before.

    * ``limit``: Number of attempts that are kept.
    """

    def __init__(self, limit: int = ATTEMPTS_KEPT) -> None:
        self._kept: deque[Attempt] = deque(maxlen=limit)
        self._verdicts = bytearray()
        self._progress: dict[int, float] = {}  # by reference frame

    def __len__(self) -> int:
        return len(self._verdicts)

    def add(self, attempt: Attempt) -> None:
        """Add an attempt."""
        none, no = np.zeros((0, 2)), np.zeros(0, bool)
        self._kept.append(replace(attempt, pixels1=none, pixels2=none, inliers=no, moving=no))
        self._verdicts.append(_VERDICTS.index(attempt.verdict))
        reference = attempt.frames[0]
        self._progress[reference] = max(self._progress.get(reference, 0.0), attempt.progress)
        tried = attempt.verdict == Verdict.ACCEPTED or attempt.stage in (Stage.TWO_VIEWS, Stage.MAP)
        _LOG.log(
            logging.INFO if tried else logging.DEBUG,
            "frames %s: %s%s",
            attempt.frames,
            attempt.verdict,
            f" ({attempt.advice})" if attempt.advice else "",
        )

    def forget_progress(self, keep: Iterable[int]) -> None:
        """Drop the progress of all pairs but those with these reference frames."""
        self._progress = {frame: self._progress.get(frame, 0.0) for frame in keep}

    @property
    def best_progress(self) -> float:
        """The best progress of the pairs whose progress was not dropped."""
        return max(self._progress.values(), default=0.0)

    @property
    def kept(self) -> tuple[Attempt, ...]:
        """The last attempts."""
        return tuple(self._kept)

    def prevailing_reason(self) -> Verdict:
        """Return the most frequent verdict of the second half of the attempts.

        The first half is not counted, because a video may start with a camera that hardly moves.

        * Returns: ``too_few_frames`` without attempts; of equally frequent verdicts the first member of
          :class:`~slam_init.types.reasons.Verdict`.
        """
        if not self._verdicts:
            return Verdict.TOO_FEW_FRAMES
        counts = Counter(self._verdicts[len(self._verdicts) // 2 :])
        return _VERDICTS[min(counts, key=lambda verdict: (-counts[verdict], verdict))]

    def advice(self, reason: Verdict) -> str:
        """Return the advice of the last kept attempt that was refused for a reason."""
        return next((a.advice for a in reversed(self._kept) if a.verdict == reason), reason.advice)

    def notes(self) -> tuple[str, ...]:
        """Write notes for the user about a suspected focal length and about attempts that are not kept."""
        notes = []
        factor = reported_focal_factor(self._kept)
        if factor is not None:
            notes.append(
                f"the matches look like those of a camera that only rotated, with a focal length {factor:.2f} times "
                "the stated one: check the calibration"
            )
        k1 = reported_distortion(self._kept)
        if k1 is not None:
            notes.append(
                f"the lens bends the image by a radial distortion k1 of {k1:+.2f} beyond the stated one: calibrate the "
                "camera, and give its distortion"
            )
        if len(self) > len(self._kept):
            notes.append(f"{len(self)} attempts were made; the last {len(self._kept)} are listed")
        return tuple(notes)


def reported_focal_factor(attempts: Iterable[Attempt]) -> float | None:
    """Return the focal factor that most checks of the calibration suspect.

    A wrong focal length is wrong in each pair. Therefore at least two checks, and more than half of all checks, have to
    suspect it, and their factors have to agree.

    * Returns: The true focal length divided by the stated one; None if the stated one is not suspected.
    """
    checked = [a.rotation_only for a in attempts if a.rotation_only is not None]
    factors = [e.suspected_focal_factor for e in checked if e.suspected_focal_factor is not None]
    if len(factors) < _LEAST_SUSPICIONS or 2 * len(factors) <= len(checked):
        return None
    factor = float(np.median(factors))
    first, second = np.triu_indices(len(factors), 1)
    alike = np.median(np.abs(np.array(factors)[first] - np.array(factors)[second])) < _ALIKE
    return factor if alike else None


def reported_distortion(attempts: Iterable[Attempt]) -> float | None:
    """Return the radial distortion that the calibration lacks by most of the last windows.

    * Returns: To be added to the first coefficient; None if the stated distortion is not suspected. At least two
      windows, and more than half of the later half of all windows, have to suspect it: early ones see too little
      motion.
    """
    windows = [a.window for a in attempts if a.window is not None]
    later = windows[len(windows) // 2 :]
    suspected = [window.suspected_distortion for window in later if window.suspected_distortion is not None]
    if len(suspected) < min(_LEAST_SUSPICIONS, len(windows)) or 2 * len(suspected) <= len(later):
        return None
    return float(np.median(suspected))


def focal_notes(map_: InitialMap | None, config: MapConfig) -> tuple[str, ...]:
    """Write a note if bundle adjustment adjusted the focal length, but the views hardly determine it.

    * Returns: Empty if the focal length was held fixed, or if the views determine it, as those of an estimate do.
    """
    if map_ is None or map_.focal_factor_sigma is None or map_.camera.source == "estimated":
        return ()
    # Below this bound the views determine the factor better than the prior does: two equal standard deviations together
    # give one that is smaller by sqrt(2).
    if map_.focal_factor_sigma < config.focal_sigma / np.sqrt(2):
        return ()
    return (
        f"the views do not determine the focal length: {map_.focal_factor:.3f} +- {map_.focal_factor_sigma:.3f} times "
        f"the stated one is hardly better than the assumption of +- {config.focal_sigma:.3g}; turn the camera while it "
        "moves",
    )
