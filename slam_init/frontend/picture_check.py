"""Finds what is wrong with the images of a sequence as pictures, and what is in them and not in the scene.

All findings only advise. They change no track.

Overlay (a burnt-in time stamp, a logo, a bonnet)
    A track that never leaves its pixel while the image moves belongs to an overlay, or to a point whose flow happens to
    be zero. The flow of a scene is continuous. It is zero at points (the focus of expansion, the axis of a roll) or, at
    worst, along a line. Beside a line, tracks that deviate by less than ``a`` are at most one in ten of those that
    deviate by less than ``10 a``. So ``k`` of ``n`` such tracks have a probability of at most ``C(n, k) 0.1^k``. An
    overlay has no slow tracks beside it: there the share is near one. Points at infinity stand still too while a camera
    translates, but only as long as it does not turn: a tenth of a degree is a pixel. So tracks are compared after half
    a second of video.

Black border (of a lens, or bars)
    Parts of the image that touch its border and are black in all frames, while the image moves. If the black part of a
    frame is mostly larger than that, the scene itself is dark: an object before a black background, a night.

Pictures
    Empty ones, few grey levels, two pictures in one: a picture of one scene has no second copy of itself. The phase
    correlation of its halves is 0.13 at most (median of a sequence; fifteen sequences), that of the two pictures of a
    stereo camera 0.86 or more.
"""

from __future__ import annotations

import math

import numpy as np

from slam_init.frontend.static_tracks import chance_of_static
from slam_init.types.arrays import Bools, Image
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
#: All is known after so many frames: their number is bounded for a video of any length.
_FRAMES_LOOKED_AT = 1000
#: An image uses the grey levels that hold this share of its pixels.
_MOST = 0.99
#: With so few grey levels, the noise of rounding is as large as the texture: four bits.
_FEW_LEVELS = 16
#: Least correlation of the two pictures of a stereo camera.
_LEAST_CORRELATION = 0.35
#: Halves are correlated at this size, in so many frames.
_SIZE, _FRAMES_CORRELATED = (128, 96), 9
#: What is known of a track: where it was at first and is now, px; how far the image had moved when it began, px; its
#: age in frames; how far it has been from its first pixel, px.
_TRACK = np.dtype([("id", "i8"), ("first", "f8", 2), ("last", "f8", 2), ("born", "f8"), ("age", "i8"), ("far", "f8")])


class PictureCheck:
    """Watches the frames of a sequence."""

    def __init__(self) -> None:
        self._tracks = np.zeros(0, _TRACK)
        self._path_px = 0.0
        self._found: tuple[int, int, int, int] | None = None
        self._brightest: Image | None = None
        self._black_cells: list[int] = []
        self._width = 0
        self._levels: list[int] = []
        self._correlations: list[tuple[float, float]] = []

    def observe(self, frame: Frame, current: Observations) -> None:
        """Take the next frame."""
        gray = frame.gray
        cells = gray[_CELL_PX // 2 :: _CELL_PX, _CELL_PX // 2 :: _CELL_PX]
        self._width = gray.shape[1]
        self._follow(current)
        if self._found is None:
            self._found = self._static_region()
        if frame.mask is None:
            self._find_black(cells)
        if len(self._levels) < _FRAMES_LOOKED_AT:
            self._levels.append(_levels_used(cells))
            if len(self._correlations) < _FRAMES_CORRELATED and self._levels[-1] > 1:
                self._correlations.append(_correlations(gray))

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
        used = [levels for levels in self._levels if levels > 1]
        if empty := len(self._levels) - len(used):
            notes.append(f"{empty} of {len(self._levels)} images are empty: all of their pixels have one grey level")
        if used and (levels := round(float(np.median(used)))) <= _FEW_LEVELS:
            notes.append(
                f"the images use {levels} grey levels only, so that few features are found: give images with more "
                "contrast, or all bits that the camera records"
            )
        places = ("side by side", "one above the other")
        for place, correlations in zip(places, zip(*self._correlations, strict=True), strict=False):
            if np.median(correlations) >= _LEAST_CORRELATION:
                notes.append(f"each image seems to hold two pictures {place}, as of a stereo camera: cut one out")
        return tuple(notes)

    # -- overlay ----------------------------------------------------------------------------------

    def _follow(self, current: Observations) -> None:
        """Update how far each track has been from its first pixel, and how far the image has moved."""
        before, tracks, pixels = self._tracks, np.zeros(len(current), _TRACK), current.pixels
        _, old, new = np.intersect1d(before["id"], current.track_ids, assume_unique=True, return_indices=True)
        if len(old):
            step_px = float(np.median(np.linalg.norm(pixels[new] - before["last"][old], axis=1)))
            self._path_px += step_px if step_px > _LEAST_STEP_PX else 0.0
        tracks["id"], tracks["first"], tracks["born"] = current.track_ids, pixels, self._path_px
        tracks[new] = before[old]
        tracks["last"] = pixels
        tracks["age"][new] += 1
        tracks["far"] = np.maximum(tracks["far"], np.linalg.norm(pixels - tracks["first"], axis=1))
        self._tracks = tracks

    def _static_region(self) -> tuple[int, int, int, int] | None:
        """Left, top, right and bottom of the static tracks, if they are an overlay."""
        for static_px in _STATIC_PX:
            path_px = self._path_px - self._tracks["born"]
            old = self._tracks[(path_px >= _LEAST_PATH * static_px) & (self._tracks["age"] >= _LEAST_AGE)]
            static, log_probability = chance_of_static(old["far"], static_px, _SLOW)
            if log_probability <= math.log(_LEAST_PROBABILITY):
                left, top = np.floor(old["last"][static].min(axis=0)).astype(int).tolist()
                right, bottom = np.ceil(old["last"][static].max(axis=0)).astype(int).tolist()
                return left, top, right, bottom
        return None

    # -- black border -----------------------------------------------------------------------------

    def _find_black(self, cells: Image) -> None:
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


def _levels_used(cells: Image) -> int:
    counts = np.sort(np.bincount(cells.ravel()))[::-1]
    return int(np.searchsorted(np.cumsum(counts), _MOST * counts.sum())) + 1


def _correlations(gray: Image) -> tuple[float, float]:
    """Phase correlations of the left half with the right one, and of the upper half with the lower one."""
    import cv2

    height, width = gray.shape
    halves = (
        (gray[:, : width // 2], gray[:, width - width // 2 :]),
        (gray[: height // 2], gray[height - height // 2 :]),
    )
    window = cv2.createHanningWindow(_SIZE, cv2.CV_32F)
    coarse = [
        [cv2.resize(half.astype(np.float32), _SIZE, interpolation=cv2.INTER_AREA) for half in pair] for pair in halves
    ]
    # Without the means, blank halves correlate with nothing.
    beside, above = (cv2.phaseCorrelate(one - one.mean(), other - other.mean(), window)[1] for one, other in coarse)
    return beside, above
