"""The attempts of a run: the last ones in full, the reason of the whole run, and the notes for the user."""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from slam_init.config import MapConfig
from slam_init.types.evidence import FreeFocal
from slam_init.types.initial_map import InitialMap
from slam_init.types.refusal import Stage, Verdict
from slam_init.types.result import Attempt, stated_reason

_LOG = logging.getLogger("slam_init")
_LOG.addHandler(logging.NullHandler())
_VERDICTS = tuple(Verdict)

#: Number of attempts that are kept in full, enough for half a minute of video. The memory of an initializer must not
#: grow with the length of the video.
#: Class: budget.
ATTEMPTS_KEPT = 1000

#: A distortion is reported if so many windows suspect it.
#: Class: assumption.
_LEAST_SUSPICIONS = 2


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
        #: The free focal length of the newest check, if it contradicts the stated one.
        self.wrong_focal: FreeFocal | None = None

    def __len__(self) -> int:
        return len(self._verdicts)

    def add(self, attempt: Attempt) -> Attempt:
        """Add an attempt.

        * Returns: The same one to be shown: where the tracks contradict the calibration, the advice is to check it.
        """
        self.add_free_focal(attempt.free_focal)
        advice = attempt.advice if self.wrong_focal is None else self.wrong_focal.note
        none, no = np.zeros((0, 2)), np.zeros(0, bool)
        self._kept.append(replace(attempt, pixels1=none, pixels2=none, inliers=no, moving=no))
        self._verdicts.append(_VERDICTS.index(attempt.verdict))
        reference = attempt.frames[0]
        self._progress[reference] = max(self._progress.get(reference, 0.0), attempt.progress)
        tried = attempt.verdict == Verdict.ACCEPTED or attempt.stage in (Stage.TWO_VIEWS, Stage.MAP)
        level, advised = logging.INFO if tried else logging.DEBUG, f" ({advice})" if advice else ""
        _LOG.log(level, "frames %s: %s%s", attempt.frames, attempt.verdict, advised)
        return replace(attempt, advice=advice)

    def add_free_focal(self, free: FreeFocal | None) -> None:
        """Take a free fit of the focal length in place of the one before: it knows more views."""
        if free is not None:
            self.wrong_focal = free if free.contradicts else None

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

        * Returns: A wrong calibration comes before what the frames lack. ``too_few_frames`` without attempts; of
          equally frequent verdicts the first member of :class:`~slam_init.types.refusal.Verdict`.
        """
        if not self._verdicts:
            return Verdict.TOO_FEW_FRAMES
        counts = Counter(self._verdicts[len(self._verdicts) // 2 :])
        return stated_reason(_VERDICTS[min(counts, key=lambda verdict: (-counts[verdict], verdict))], self.wrong_focal)

    def advice(self, reason: Verdict) -> str:
        """Return what to do about a reason: check a wrong calibration, else the advice of the last attempt with it."""
        if self.wrong_focal is not None:
            return self.wrong_focal.note
        return next((a.advice for a in reversed(self._kept) if a.verdict == reason), reason.advice)

    def notes(self) -> tuple[str, ...]:
        """Write notes for the user about a wrong calibration and about attempts that are not kept."""
        notes = []
        k1 = reported_distortion(self._kept)
        if self.wrong_focal is not None:
            notes.append(self.wrong_focal.note)
        elif k1 is not None:  # a wrong focal length bends the rays too
            notes.append(
                f"the lens bends the image by a radial distortion k1 of {k1:+.2f} beyond the stated one: calibrate the "
                "camera, and give its distortion"
            )
        if len(self) > len(self._kept):
            notes.append(f"{len(self)} attempts were made; the last {len(self._kept)} are listed")
        return tuple(notes)


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
