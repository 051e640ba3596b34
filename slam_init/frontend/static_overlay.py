"""Finds what is in the image and not in the scene: a burnt-in time stamp, a logo, a bonnet, the border of a lens.

Both tests only advise to give a mask. They change no track.

Overlay
    A track that never leaves its pixel while the image moves belongs to an overlay, or to a point whose flow happens to
    be zero. The flow of a scene is continuous. It is zero at points (the focus of expansion, the axis of a roll) or, at
    worst, along a line. Beside a line, tracks that deviate by less than ``a`` are at most one in ten of those that
    deviate by less than ``10 a``. So ``k`` of ``n`` such tracks have a probability of at most ``C(n, k) 0.1^k``. An
    overlay has no slow tracks beside it: there the share is near one. Points at infinity stand still too while a camera
    translates, but only as long as it does not turn: a tenth of a degree is a pixel. So tracks are compared after half
    a second of video.

Black border
    Parts of the image that touch its border and are black in all frames, while the image moves. If the black part of a
    frame is mostly larger than that, the scene itself is dark: an object before a black background, a night.
"""

from __future__ import annotations

import math

import numpy as np

from slam_init.types.arrays import Bools, Floats, Image, Ints
from slam_init.types.frame import Frame, Observations

#: Static tracks deviate from their first pixel by less than one of these, in pixels: an overlay is static but for the
#: noise of compression, and patches at the edge of a thin text see the scene behind it as well.
_STATIC_PX = (0.5, 1.0, 1.5)
#: Static tracks are compared with those that deviate by this many times more.
_SLOW = 10.0
#: The image has to move by more than the slow tracks since a track began.
_LEAST_PATH = 1.2 * _SLOW
#: A track has to be this old, in frames: half a second of video, in which a hand or a vehicle turns.
_LEAST_AGE = 15
#: Steps of the median track below this are noise and no motion of the image.
_LEAST_STEP_PX = 0.3
#: The border of an image that moves by less than this share of its width is no evidence: 32 px of 640.
_LEAST_MOTION = 0.05
#: Each frame is tested: one false advice in a million sequences of a thousand frames.
_LEAST_PROBABILITY = 1e-6 * 1e-3
#: Black is 16 in the limited range of videos; noise and the offset of a sensor stay below it in full range.
_BLACK = 16
#: What is not black has to be bright: four times as much.
_BRIGHT = 64
#: One pixel of each square of this size is looked at.
_CELL_PX = 8
#: A smaller share of the image costs no tracks.
_LEAST_BORDER = 0.01
#: The black part of the median frame over the part that is black in all frames: the edge of a lens stays where it is.
_LARGEST_GROWTH = 1.15
#: The median frame is known after so many: their number is bounded for a video of any length.
_FRAMES_LOOKED_AT = 1000


class StaticOverlay:
    """Watches the frames of a sequence for parts of the image that do not move with it."""

    def __init__(self) -> None:
        self._ids: Ints = np.zeros(0, np.int64)
        self._first: Floats = np.zeros((0, 2))
        self._last: Floats = np.zeros((0, 2))
        self._born: Floats = np.zeros(0)
        self._age: Ints = np.zeros(0, np.int64)
        self._deviation: Floats = np.zeros(0)
        self._path_px = 0.0
        self._found: tuple[int, int, int, int] | None = None
        self._brightest: Image | None = None
        self._black_cells: list[int] = []
        self._width = 0

    def observe(self, frame: Frame, current: Observations) -> None:
        """Take the next frame."""
        self._width = frame.image.shape[1]
        self._follow(current)
        if self._found is None:
            self._found = self._static_region()
        if frame.mask is None:
            self._look(frame.gray)

    @property
    def notes(self) -> tuple[str, ...]:
        """Advice for the user."""
        notes: list[str] = []
        if self._found is not None:
            left, top, right, bottom = self._found
            notes.append(
                f"the image has a static overlay in columns {left} to {right}, rows {top} to {bottom} (a time stamp, a "
                "logo, a part of the vehicle): give --mask with an image that is black there"
            )
        border = self._border()
        if border >= _LEAST_BORDER:
            notes.append(
                f"{border:.0%} of the image is black in all frames (the border of the lens, or bars): give --mask with "
                "an image that is black there"
            )
        return tuple(notes)

    # -- overlay ----------------------------------------------------------------------------------

    def _follow(self, current: Observations) -> None:
        """Update how far each track has been from its first pixel, and how far the image has moved."""
        ids, pixels = current.track_ids, current.pixels
        _, old, new = np.intersect1d(self._ids, ids, assume_unique=True, return_indices=True)
        if len(old):
            step_px = float(np.median(np.linalg.norm(pixels[new] - self._last[old], axis=1)))
            self._path_px += step_px if step_px > _LEAST_STEP_PX else 0.0
        first, born = pixels.copy(), np.full(len(ids), self._path_px)
        deviation, age = np.zeros(len(ids)), np.zeros(len(ids), np.int64)
        first[new], born[new], age[new] = self._first[old], self._born[old], self._age[old] + 1
        deviation[new] = np.maximum(self._deviation[old], np.linalg.norm(pixels[new] - first[new], axis=1))
        self._ids, self._first, self._last = ids, first, pixels
        self._born, self._deviation, self._age = born, deviation, age

    def _static_region(self) -> tuple[int, int, int, int] | None:
        """Left, top, right and bottom of the static tracks, if they are an overlay."""
        for static_px in _STATIC_PX:
            old_enough = (self._path_px - self._born >= _LEAST_PATH * static_px) & (self._age >= _LEAST_AGE)
            static = old_enough & (self._deviation < static_px)
            k, n = int(static.sum()), int((old_enough & (self._deviation < _SLOW * static_px)).sum())
            if k and math.log(math.comb(n, k)) - k * math.log(_SLOW) <= math.log(_LEAST_PROBABILITY):
                left, top = np.floor(self._last[static].min(axis=0)).astype(int).tolist()
                right, bottom = np.ceil(self._last[static].max(axis=0)).astype(int).tolist()
                return left, top, right, bottom
        return None

    # -- black border -----------------------------------------------------------------------------

    def _look(self, gray: Image) -> None:
        cells = gray[_CELL_PX // 2 :: _CELL_PX, _CELL_PX // 2 :: _CELL_PX]
        if self._brightest is None or self._brightest.shape != cells.shape:
            self._brightest, self._black_cells = cells.copy(), []
        np.maximum(self._brightest, cells, out=self._brightest)
        if len(self._black_cells) < _FRAMES_LOOKED_AT:
            self._black_cells.append(int(_at_border(cells).sum()))

    def _border(self) -> float:
        """Share of the image that is black in all frames, and that is no part of a dark scene."""
        if self._brightest is None or self._path_px < _LEAST_MOTION * self._width:
            return 0.0
        black = _at_border(self._brightest)
        always = int(black.sum())
        if not always or float(np.median(self._black_cells)) > _LARGEST_GROWTH * always:
            return 0.0
        rest = self._brightest[~black]
        return always / black.size if len(rest) and float(np.median(rest)) >= _BRIGHT else 0.0


def _at_border(cells: Image) -> Bools:
    """The black cells (H, W) that touch the border, or other such cells."""
    import cv2

    black = (cells <= _BLACK).astype(np.uint8)
    if not black.any():
        return black > 0
    count, labels = cv2.connectedComponents(black, connectivity=4)
    at_border = np.zeros(count, bool)
    for side in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        at_border[side] = True
    at_border[0] = False  # the label of what is not black
    return np.asarray(at_border[labels], bool)
