"""Keyframe manager: chooses the earlier frame that is paired with the current one.

The manager keeps a bounded window of candidate reference frames. For each candidate, the rotation that best aligns the
common tracks is removed; the remaining displacement is parallax (and noise). The pairs are ranked by the expected
precision of the direction of the baseline. Its standard deviation is proportional to noise / (parallax sqrt(n)) for n
tracks. Therefore the score of a pair is its parallax times sqrt(n), reduced where the tracks cover only a part of the
image.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from quest.geometry.quaternion import rotation_angle
from quest.robust.rotation import refine_rotation
from slam_init.config import Config
from slam_init.types.camera import Camera
from slam_init.types.evidence import PreviewEvidence
from slam_init.types.frame import Observations
from slam_init.types.history import History, common_tracks

#: The spread of the tracks is counted in the cells of this grid over the image.
_GRID = (8, 6)
#: Makes one number of the column and row of a cell: rows of an array take ten times as long to compare.
_ONE_NUMBER = (1 << 32, 1)
#: Longest wait after repeated failures, in units of ``new_after_frames``: after some seconds of video the rest of the
#: scene may have changed.
_LONGEST_WAIT = 8
#: A frame is blurred where its tracks were followed with twice the variance of the last second of video. It becomes no
#: candidate while a sharp frame may follow soon: a hand is at rest between two swings.
#: Class: assumption, in standard deviations and frames.
_BLURRED, _SECOND_FRAMES = float(np.sqrt(2)), 30
#: Two frames that share half of their tracks see the same scene.
#: Class: assumption.
SAME_SCENE = 0.5
#: A candidate is dropped after 300 frames, since tracks drift and drift looks like parallax. In 600 to 900 frames of
#: pure rotation, a tenth of the tracks of the oldest candidate drifted by 2 px, and the candidate was tried repeatedly.
#: Class: measured.
_OLDEST_FRAMES = 300


@dataclass(frozen=True)
class PairPreview(PreviewEvidence):
    """Properties of a pair of frames that are known before any epipolar geometry."""

    #: reference, current: Absolute frame indices.
    reference: int
    current: int
    #: Number of common tracks over that of the frame with more tracks; 0 if there are fewer than 3 common tracks.
    overlap: float

    @property
    def evidence(self) -> PreviewEvidence:
        """The figures without the frames."""
        return PreviewEvidence(**{one.name: getattr(self, one.name) for one in fields(PreviewEvidence)})

    @property
    def direction_score(self) -> float:
        """Expected precision of the baseline's direction, in arbitrary units: parallax times sqrt(tracks x spread)."""
        return self.parallax_px * float(np.sqrt(self.matches * self.spread))


def difference_gate(noise: float) -> float:
    """Compute three standard deviations of the difference of two measurements."""
    return 3 * float(np.sqrt(2)) * noise


def preview_pairs(
    camera: Camera, references: Sequence[Observations], current: Observations, noise_px: float
) -> list[PairPreview]:
    """Remove the best rotation from each reference to a frame, and measure the remaining displacement of the tracks.

    * Returns: In the order of the references, with zero motion and parallax for fewer than 3 common tracks.
    """
    return [_preview(camera, reference, current, noise_px) for reference in references]


def _preview(camera: Camera, reference: Observations, current: Observations, noise_px: float) -> PairPreview:
    i, j = common_tracks(reference, current)
    if len(i) < 3:
        return PairPreview(len(i), 0.0, 0.0, 0.0, 0.0, 0.0, reference.frame, current.frame, 0.0)
    m, n, pixels = reference.bearings[i], current.bearings[j], current.pixels[j]
    motion_px = float(np.percentile(np.linalg.norm(pixels - reference.pixels[i], axis=1), 90))
    gate_px = difference_gate(noise_px)
    # The scale of the robust kernel starts wide, so that every track counts, and decreases to the noise gate.
    scales_px = np.array([0.1 * camera.focal_px, 8 * gate_px, gate_px])
    R = refine_rotation(np.eye(3), m, n, *scales_px / camera.focal_px, iterations=4)
    left_px = np.linalg.norm(n - m @ R.T, axis=1) * camera.focal_px
    cells = np.clip((pixels / (camera.width, camera.height) * _GRID).astype(int), 0, np.subtract(_GRID, 1))
    return PairPreview(
        reference=reference.frame,
        current=current.frame,
        matches=len(i),
        overlap=len(i) / max(len(reference), len(current)),
        motion_px=motion_px,
        rotation_deg=float(np.degrees(rotation_angle(R))),
        parallax_px=float(np.median(left_px)),
        parallax_share=float(np.mean(left_px > gate_px)),
        spread=len(np.unique(cells @ _ONE_NUMBER)) / (_GRID[0] * _GRID[1]),
    )


@dataclass(frozen=True)
class _RetryCondition:
    """When a pair is tried again: once its score reaches ``min_score``, or from frame ``from_frame`` on."""

    min_score: float
    from_frame: int
    wait_frames: int

    def is_met_by(self, pair: PairPreview) -> bool:
        return pair.direction_score >= self.min_score or pair.current >= self.from_frame


class KeyframeManager:
    """Keeps the candidate reference frames and chooses the pair to try with the current frame.

    * ``candidates``: Absolute indices of the candidate reference frames, ascending.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self.candidates: list[int] = []
        self._steps_px: deque[float] = deque(maxlen=_SECOND_FRAMES)
        self._retry: dict[int, _RetryCondition] = {}  # of each reference whose last pair failed
        # The indices of a subsampled source are far apart: numbers of frames are multiples of their least step.
        self._last: int | None = None
        self._step: int | None = None

    def preview(self, history: History, current: Observations) -> list[PairPreview]:
        """Preview the pairs of all candidates with the current frame."""
        if self._last is not None and current.frame > self._last:
            step = current.frame - self._last
            self._step = step if self._step is None else min(self._step, step)
        self._last = current.frame
        noise_px = self._config.map.noise_px
        pairs = preview_pairs(history.camera, [history[frame] for frame in self.candidates], current, noise_px)
        return sorted(pairs, key=lambda pair: -pair.direction_score)

    def best_pair_to_try(self, pairs: list[PairPreview]) -> PairPreview | None:
        """Choose the best pair that has enough matches and need not wait after a failure."""
        settings = self._config.keyframes
        for pair in pairs:
            if pair.matches < settings.min_matches:
                continue
            retry = self._retry.get(pair.reference)
            if retry is None or retry.is_met_by(pair):
                return pair
        return None

    def failed(self, pair: PairPreview) -> None:
        """Record that the pair did not lead to a map."""
        settings = self._config.keyframes
        gain = settings.retry_gain
        # Where the parallax is small compared with the noise, the score hardly grows. But in a steady motion the
        # baseline does: after this number of frames it has grown by ``gain``. After each further failure without a
        # higher score the wait is doubled; otherwise a window of hopeless references would be tried on every frame.
        frames = int(np.ceil(round((gain - 1) * (pair.current - pair.reference), 6)))
        last, wait = self._retry.get(pair.reference), max(1, min(frames, self._new_after))
        if last is not None and pair.direction_score < last.min_score:
            wait = min(2 * last.wait_frames, _LONGEST_WAIT * self._new_after)
        self._retry[pair.reference] = _RetryCondition(gain * pair.direction_score, pair.current + wait, wait)

    def update(self, current: Observations, pairs: list[PairPreview]) -> None:
        """Add the current frame to the candidates if a new one is due, and drop the least useful candidates.

        A new candidate is due if the newest candidate is old enough or shares too few tracks with the current frame. A
        blurred frame is left out where the next frames will do as well.

        * ``pairs``: All candidates paired with the current frame, as returned by :meth:`preview`.
        """
        settings = self._config.keyframes
        blurred = self._is_blurred(current)
        if self.candidates:
            newest = max(self.candidates)
            to_newest = next(pair for pair in pairs if pair.reference == newest)
            if to_newest.overlap >= settings.new_overlap and current.frame - newest < self._new_after:
                return
            if blurred and to_newest.overlap >= SAME_SCENE and current.frame - newest < 2 * self._new_after:
                return
            # The new candidate sees the same scene as the newest one. So the new candidate waits until it reaches the
            # same score, or until it is ``new_after_frames`` frames old; from then on its score does not matter.
            if newest in self._retry and to_newest.overlap >= SAME_SCENE:
                later = current.frame + self._new_after
                self._retry[current.frame] = replace(self._retry[newest], from_frame=later)
        # Candidates that lost their tracks are dropped first, then those with the lowest score.
        by_use = sorted(pairs, key=lambda p: (p.matches >= settings.min_matches, p.direction_score, -p.reference))
        dropped = {p.reference for p in by_use[: max(len(pairs) + 1 - settings.window, 0)]}
        dropped |= {frame for frame in self.candidates if current.frame - frame > _OLDEST_FRAMES * (self._step or 1)}
        self.candidates = [*(frame for frame in self.candidates if frame not in dropped), current.frame]
        self._retry = {frame: retry for frame, retry in self._retry.items() if frame in self.candidates}

    @property
    def _new_after(self) -> int:
        """The option ``new_after_frames`` as a difference of indices."""
        return self._config.keyframes.new_after_frames * (self._step or 1)

    def _is_blurred(self, current: Observations) -> bool:
        """Whether the tracks of a frame are noisier than those of the last second."""
        usual_px = float(np.median(self._steps_px)) if self._steps_px else 0.0
        if current.step_px > 0:
            self._steps_px.append(current.step_px)
        return 0 < _BLURRED * usual_px < current.step_px
