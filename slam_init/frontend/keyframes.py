"""Keyframe manager: which earlier frame to pair the current one with.

A bounded window of candidate reference frames is kept. For each, the rotation that best aligns the common tracks is
removed; what is left over is parallax (and noise). Pairs are ranked by what they promise for the direction of the
baseline, whose standard deviation goes as noise / (parallax sqrt(n)): the promise is parallax times the square root of
the number of tracks, less where they crowd in a part of the image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quest.geometry.quaternion import rotation_angle
from quest.robust.rotation import refine_rotation_compiled
from slam_init.config import Config
from slam_init.frontend.tracks import History, common_tracks
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations

__all__ = ["KeyframeManager", "PairPreview", "difference_gate", "preview_pair"]

#: The spread of the tracks is counted on this grid of the image.
_GRID = (8, 6)
#: A pair that fails again and again waits no longer than this many times the first wait: after some seconds of video
#: the rest of the scene may have changed.
_LONGEST_WAIT = 8
#: A map that is refused costs as much time as this many frames of video: so long all rest, unless one promises more.
_REST_FRAMES = 3
#: Two frames that share half of their tracks see the same scene.
_SAME_SCENE = 0.5
#: Tracks drift, and drift looks like parallax: over 600 to 900 frames of pure rotation, a tenth of those with the
#: oldest candidate came to be off by 2 px, and it was tried again and again. Half of that is kept.
_OLDEST_FRAMES = 300


@dataclass(frozen=True)
class PairPreview:
    """What is known about a pair of frames before any epipolar geometry.

    Attributes
    ----------
    reference, current : int
        Absolute frame indices.
    matches : int
        Common tracks.
    overlap : float
        Common tracks, as a share of those in the frame that has more: a frame without features overlaps with nothing.
    motion_px : float
        90th percentile of the displacement of the tracks.
    rotation_deg : float
        Angle of the rotation that aligns the tracks best.
    parallax_px : float
        Median displacement that this rotation leaves.
    parallax_share : float
        Share of the tracks that are displaced by more than noise after the rotation is removed.
    spread : float
        Share of the image's grid cells that hold a common track, in (0, 1].
    """

    reference: int
    current: int
    matches: int
    overlap: float
    motion_px: float
    rotation_deg: float
    parallax_px: float
    parallax_share: float
    spread: float

    @property
    def promise(self) -> float:
        """Grows as the direction of the baseline gets more certain."""
        return self.parallax_px * float(np.sqrt(self.matches * self.spread))


def difference_gate(noise: float) -> float:
    """Three standard deviations of the difference of two measurements with this noise each."""
    return 3 * float(np.sqrt(2)) * noise


def preview_pair(camera: Camera, reference: Observations, current: Observations, noise_px: float) -> PairPreview:
    """Remove the best rotation between two frames and measure what is left."""
    i, j = common_tracks(reference, current)
    if len(i) < 3:
        return PairPreview(reference.frame, current.frame, len(i), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    m, n = reference.bearings[i], current.bearings[j]
    motion_px = float(np.percentile(np.linalg.norm(current.pixels[j] - reference.pixels[i], axis=1), 90))
    gate_px = difference_gate(noise_px)
    R = np.eye(3)
    # From a scale at which every track has a say down to the noise.
    for scale_px in (0.1 * camera.focal_px, 8 * gate_px, gate_px):
        R = refine_rotation_compiled(R, m, n, scale_px / camera.focal_px, iterations=4)
    left_px = np.linalg.norm(n - m @ R.T, axis=1) * camera.focal_px
    cells = (current.pixels[j] / (camera.width, camera.height) * _GRID).astype(int)
    return PairPreview(
        reference=reference.frame,
        current=current.frame,
        matches=len(i),
        overlap=len(i) / max(len(reference), len(current)),
        motion_px=motion_px,
        rotation_deg=float(np.degrees(rotation_angle(R))),
        parallax_px=float(np.median(left_px)),
        parallax_share=float(np.mean(left_px > gate_px)),
        spread=len(np.unique(cells, axis=0)) / (_GRID[0] * _GRID[1]),
    )


@dataclass(frozen=True)
class _Failure:
    """What a reference has to wait for: as much promise as ``needed``, or the frame ``again``."""

    needed: float
    again: int
    wait: int

    def over(self, pair: PairPreview) -> bool:
        """Whether a pair need not wait any more."""
        return pair.promise >= self.needed or pair.current >= self.again


class KeyframeManager:
    """Keeps the candidate references and offers pairs with the current frame.

    Parameters
    ----------
    camera : Camera
    config : Config
    """

    def __init__(self, camera: Camera, config: Config) -> None:
        self._camera = camera
        self._config = config
        self.candidates: list[int] = []
        self._failed: dict[int, _Failure] = {}  # by reference
        self._rest = _Failure(0.0, 0, 0)  # of any reference

    def preview(self, history: History, current: Observations) -> list[PairPreview]:
        """Pairs of the candidates with the current frame, the most promising first."""
        noise_px = self._config.map.noise_px
        pairs = [preview_pair(self._camera, history[f], current, noise_px) for f in self.candidates]
        return sorted(pairs, key=lambda pair: -pair.promise)

    def worth_trying(self, pairs: list[PairPreview]) -> PairPreview | None:
        """The best pair that promises more than it did when it failed."""
        settings = self._config.keyframes
        for pair in pairs:
            if pair.matches < settings.min_matches:
                continue
            failure = self._failed.get(pair.reference)
            if not self._rest.over(pair):
                continue
            if failure is None or failure.over(pair):
                return pair
        return None

    def failed(self, pair: PairPreview, lacking: float = 1.0, *, as_map: bool = False) -> None:
        """Remember that the pair did not lead to a map.

        Parameters
        ----------
        pair : PairPreview
        lacking : float
            Factor by which the worst gate was missed; for the gates that go with the inverse of the parallax the pair
            has to promise that much more.
        as_map : bool
            Whether a map was built and refused, which costs the time of some frames: no other pair is tried meanwhile.
        """
        settings = self._config.keyframes
        # Promise and gates are no exact multiples of each other: four fifths of the way are close enough to look again.
        gain = min(max(settings.retry_gain, 0.8 * lacking), settings.max_retry_gain)
        # Where little parallax drowns in noise the promise hardly grows, but in a steady motion the way does: after so
        # many frames it is longer by that gain. Each time in vain the pair waits twice as long, else a window of
        # hopeless references would be tried on every frame.
        frames = int(np.ceil(round((gain - 1) * (pair.current - pair.reference), 6)))
        last, wait = self._failed.get(pair.reference), max(1, min(frames, settings.new_after_frames))
        if last is not None and pair.promise < last.needed:
            wait = min(2 * last.wait, _LONGEST_WAIT * settings.new_after_frames)
        self._failed[pair.reference] = _Failure(gain * pair.promise, pair.current + wait, wait)
        if as_map:
            self._rest = _Failure(settings.retry_gain * pair.promise, pair.current + _REST_FRAMES, _REST_FRAMES)

    def update(self, current: Observations, pairs: list[PairPreview]) -> None:
        """Let the current frame become a candidate where the newest one grows old, and drop useless ones."""
        settings = self._config.keyframes
        if self.candidates:
            newest = max(self.candidates)
            to_newest = next(pair for pair in pairs if pair.reference == newest)
            if to_newest.overlap >= settings.new_overlap and current.frame - newest < settings.new_after_frames:
                return
            # It sees what its neighbour saw: what was not enough there is not enough here, nor before it is as old as
            # its neighbour was when it became one.
            if newest in self._failed and to_newest.overlap >= _SAME_SCENE:
                later = current.frame + settings.new_after_frames
                self._failed[current.frame] = replace(self._failed[newest], again=later)
        # A candidate that lost its tracks is of no use any more; next goes the one that promises least.
        by_use = sorted(pairs, key=lambda p: (p.matches >= settings.min_matches, p.promise, -p.reference))
        dropped = {p.reference for p in by_use[: max(len(pairs) + 1 - settings.window, 0)]}
        dropped |= {frame for frame in self.candidates if current.frame - frame > _OLDEST_FRAMES}
        self.candidates = [*(frame for frame in self.candidates if frame not in dropped), current.frame]
        self._failed = {frame: failure for frame, failure in self._failed.items() if frame in self.candidates}
