"""Lucas-Kanade flow from one frame to the next, and how far each track has drifted.

The flow minimizes the difference of two image patches. To first order, the covariance of its displacement is
``sigma_I^2 G^-1``: ``sigma_I`` is what remains of the difference, and ``G`` the sum of the products of the gradients
over the patch. Blur lowers the gradients along the motion, so that a track slides along its trail; a flicker, an
occlusion or a reflection raises the remainder. The next step starts where the last one ended. So the covariances of the
steps add up: this is the drift of a track, until its patch brings it back to its point
(:mod:`~slam_init.frontend.patches`).

On rendered images with up to 16 px of blur, the errors of a step are 0.6 to 1.1 times these standard deviations (see
``_SCALE``) in the weak direction and in the strong one alike, while they themselves grow four times; beyond 16 px of
blur 1.3 and 1.8 times.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from slam_init.config import TrackingConfig
from slam_init.frontend.sift import first_per_cell
from slam_init.types.arrays import Bools, Floats, Floats32, Image, Ints

#: Standard deviation of a step over the mean absolute difference of the patches by the root of the mean squared
#: gradient, measured on rendered images. With independent errors of the pixels it would be 0.06: 1.25 over the root of
#: 441 pixels.
_SCALE = 0.13
#: A trail of L px lowers the mean squared gradient along it to a share of 1 / (1 + L / 7) of that across it: on
#: rendered images to 0.62 at 4.7 px, 0.43 at 9.5 px, 0.37 at 15 px.
_SHARP_PX = 7.0
#: Trails are measured where most points move by more than this between two frames: shorter ones look like corners.
_LEAST_MOTION_PX = 8.0
#: The exposure is the median over this number of such frames: the share of gradients along the motion depends on what
#: the camera sees.
_TRAIL_FRAMES = 15
#: The flow assumes equal brightness. A change of the mean by less is left to it: what the camera sees changes too.
_LEAST_GAIN = 1.05
#: Pixels of an image in one of the coarse image that gives the gain: a shift between two photographs is then a few
#: pixels of the coarse images.
_COARSE_PX = 8
#: Gradients are sampled at every second pixel of each row and column: a patch has a hundred samples then.
_STEP_PX = 2
#: Added to the mean squares of gradients, so that a flat patch has a finite covariance: a few times the 0.02 that
#: rounding grey levels makes.
_ROUNDING = 0.1
#: What the motion of a patch leaves at an edge, px: it turns, bends, and hides what is behind it. Unlike noise it is
#: alike along the edge and does not average out, so that a track slides along the edge by this times the ratio of the
#: slopes across and along. Across the epipolar lines of true poses, tracks whose ratio is 2, 4, 7 and 15 are off by .1,
#: .13, .2 and .5 px (median), and some by the length of the edge.
#: Class: measured.
MISFIT_PX = 0.05


@dataclass(frozen=True, eq=False)
class Flow:
    """The flow of points into the next frame."""

    #: (N,) Whether each point survives.
    kept: Bools
    #: (N, 2) Where the points are in the next frame.
    pixels: Floats
    #: (N, 2, 2) Of the errors of the displacements, px^2.
    covariances: Floats
    #: (N,) Mean absolute difference of the patches, grey levels; 0 for a point that is lost.
    remainders: Floats
    #: Length of the trails of a blurred image over the displacement: the exposure in units of the frame interval.
    #: None where the points move too little.
    trail: float | None
    #: Standard deviation of a typical displacement, px: the median of the geometric means over both directions; 0 where
    #: no point survives.
    step_px: float

    def copy(self) -> Flow:
        """The same with arrays of its own."""
        arrays = (self.kept.copy(), self.pixels.copy(), self.covariances.copy(), self.remainders.copy())
        return Flow(*arrays, self.trail, self.step_px)

    def put(self, rows: Ints, other: Flow) -> None:
        """Take the flow of some of the points, (M,), from elsewhere."""
        self.kept[rows], self.pixels[rows] = other.kept, other.pixels
        self.covariances[rows], self.remainders[rows] = other.covariances, other.remainders


def flow(
    before: Image,
    after: Image,
    pixels: Floats,
    config: TrackingConfig,
    expected: Floats | None = None,
    *,
    and_back: bool = True,
) -> Flow:
    """Follow points forward, and back as a check.

    Points that are not found where they are expected are sought in all octaves.

    Shapes: ``before, after`` (H, W), ``pixels, expected`` (N, 2).

    * ``expected``: Where the points are in the next frame to within some pixels; NaN where that is not known.
    * ``and_back``: Whether points must come back. Without it each point that is found survives.
    """
    if len(pixels) == 0:
        return Flow(np.zeros(0, bool), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), None, 0.0)
    before, after = _equally_bright(before, after)
    start, end, remainders = pixels.astype(np.float32), pixels.astype(np.float32), np.zeros(len(pixels))
    closed = np.zeros(len(pixels), bool)

    def seek(sought: Ints, first: Floats32 | None) -> None:
        if not len(sought):
            return
        end[sought], closed[sought], remainders[sought] = _lucas_kanade(before, after, start[sought], first, config)
        # A point that is lost already needs no check.
        found = sought[closed[sought]]
        if and_back and len(found):
            back, closed[found], _ = _lucas_kanade(after, before, end[found], start[found], config)
            closed[found] &= np.linalg.norm(back - start[found], axis=1) < config.forward_backward_px

    if expected is not None:
        known = np.flatnonzero(np.isfinite(expected).all(axis=1))
        seek(known, expected[known].astype(np.float32))
    seek(np.flatnonzero(~closed), None)
    survivors, moved = np.flatnonzero(closed), end.astype(float)
    # Of two tracks that meet in one place only the older is kept.
    kept = np.zeros(len(start), bool)
    kept[survivors[first_per_cell(moved[survivors], 0.5 * config.min_distance * after.shape[1])]] = True
    # Nothing is known of a point that is lost.
    covariances = np.broadcast_to(np.eye(2), (len(pixels), 2, 2)).copy()
    products = gradient_products(after, moved[kept], config.window_px)
    remainders[~kept] = 0.0
    squares = (_SCALE * remainders[kept]) ** 2 + MISFIT_PX**2 * anisotropy(products)
    xx, xy, yy = products[:, 0, 0], products[:, 0, 1], products[:, 1, 1]
    determinants = xx * yy - xy**2
    inverses = np.stack([np.stack([yy, -xy], axis=1), np.stack([-xy, xx], axis=1)], axis=1)
    covariances[kept] = (squares / determinants)[:, None, None] * inverses
    step_px = float(np.median(squares**2 / determinants)) ** 0.25 if kept.any() else 0.0
    return Flow(kept, moved, covariances, remainders, _trail(products, (moved - pixels)[kept]), step_px)


def _lucas_kanade(
    before: Image, after: Image, start: Floats32, first: Floats32 | None, config: TrackingConfig
) -> tuple[Floats32, Bools, Floats]:
    """The ends of points (N, 2), which were found in the image, and what remains of their patches, grey levels.

    * ``first``: Where they are to within some pixels, so that the finest two octaves find them; None for all octaves.
    """
    import cv2

    levels, flags = (config.pyramid_levels, 0) if first is None else (1, cv2.OPTFLOW_USE_INITIAL_FLOW)
    end, found, remainder = cv2.calcOpticalFlowPyrLK(
        before, after, start, np.empty_like(start) if first is None else first.copy(),
        winSize=(config.window_px, config.window_px), maxLevel=levels, flags=flags,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01),
    )  # fmt: skip
    height, width = after.shape
    inside = (end >= 0).all(axis=1) & (end[:, 0] <= width - 1) & (end[:, 1] <= height - 1)
    reached = (found.ravel() > 0) & inside
    return np.asarray(end, np.float32), reached, np.where(reached, remainder.ravel(), 0.0).astype(float)


def _equally_bright(before: Image, after: Image) -> tuple[Image, Image]:
    """Both images with the brightness of the darker one: lamps flicker, and an exposure adapts."""
    import cv2

    means = [max(float(cv2.mean(one)[0]), 1.0) for one in (before, after)]
    if max(means) < _LEAST_GAIN * min(means):
        return before, after
    gain = _gain(before, after)
    if max(gain, 1 / gain) < _LEAST_GAIN:
        return before, after
    if gain < 1:
        return np.asarray(cv2.convertScaleAbs(before, alpha=gain), np.uint8), after
    return before, np.asarray(cv2.convertScaleAbs(after, alpha=1 / gain), np.uint8)


def _gain(before: Image, after: Image) -> float:
    """The brightness of what both images show, after over before.

    The means of the images would count a dark wall that comes into view as a gain. So the coarse images are aligned
    first, by the phase of their spectra, which a gain leaves alone.
    """
    import cv2

    width, height = (max(size // _COARSE_PX, 8) for size in before.shape[::-1])
    coarse = [
        cv2.resize(one, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32) for one in (before, after)
    ]
    (dx, dy), _ = cv2.phaseCorrelate(coarse[0], coarse[1], cv2.createHanningWindow((width, height), cv2.CV_32F))
    x, y = round(dx), round(dy)
    ahead = coarse[1][max(y, 0) : height + min(y, 0), max(x, 0) : width + min(x, 0)]
    behind = coarse[0][max(-y, 0) : height + min(-y, 0), max(-x, 0) : width + min(-x, 0)]
    return (float(ahead.sum()) + 1) / (float(behind.sum()) + 1)


def gradient_products(image: Image, pixels: Floats, window_px: int) -> Floats:
    """Mean products of the gradients over the patches around pixels, at every second pixel of each row and column.

    Shapes: ``image`` (H, W), ``pixels`` (N, 2), returns (N, 2, 2).
    """
    from slam_init.frontend.gradient_kernel import sums_of_products

    radius = window_px // (2 * _STEP_PX)
    last = (np.array(image.shape) - 1) // _STEP_PX
    centres = np.clip(np.round(pixels[:, ::-1] / _STEP_PX).astype(int), 0, last)
    # The loop is compiled for arrays like most images: of one piece, and not read-only.
    sums = sums_of_products(np.require(image, requirements=["C", "W"]), centres, radius, _STEP_PX)
    # Gradients are eight times the slope.
    xx, xy, yy = (sums.T / 64 * (1 / (2 * radius + 1) ** 2)).astype(np.float32).astype(float)
    return np.stack([np.stack([xx + _ROUNDING, xy], axis=1), np.stack([xy, yy + _ROUNDING], axis=1)], axis=1)


def anisotropy(products: Floats) -> Floats:
    """Differences (N,) of the eigenvalues of structure tensors (N, 2, 2): 0 where the slopes have no direction."""
    xx, xy, yy = products[:, 0, 0], products[:, 0, 1], products[:, 1, 1]
    return np.asarray(np.hypot(xx - yy, 2 * xy))


def _trail(products: Floats, motions: Floats) -> float | None:
    """Length of the trails over the displacement, from the products of the gradients along and across it."""
    lengths = np.linalg.norm(motions, axis=1)
    if not len(lengths) or np.median(lengths) < _LEAST_MOTION_PX:
        return None
    # A track that stands still, as on an overlay, has no trail and no direction.
    moved = lengths > 0
    motions, products, lengths = motions[moved], products[moved], lengths[moved]
    along = motions / lengths[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    squares = (np.einsum("ni,nij,nj->n", one, products, one) for one in (along, across))
    share = min(float(np.median(np.divide(*squares))), 1.0)
    return min(_SHARP_PX * (1 / share - 1) / float(np.median(lengths)), 1.0)


class Exposure:
    """The exposure time of a camera, from the trails of its blurred images."""

    def __init__(self) -> None:
        self._found: deque[float] = deque(maxlen=_TRAIL_FRAMES)

    def update(self, trail: float | None, interval_s: float) -> float:
        """Take the trails of a frame.

        * Returns: The exposure time in seconds; 0 where no image showed a trail.
        """
        if trail is not None and interval_s > 0:
            self._found.append(trail * interval_s)
        return float(np.median(self._found)) if self._found else 0.0


class Drift:
    """How far the tracks have drifted since they began."""

    def __init__(self) -> None:
        self._ids, self._sums = np.zeros(0, np.int64), np.zeros((0, 2, 2))

    def follow(self, track_ids: Ints, covariances: Floats) -> None:
        """Take the step of the tracks that survive a flow.

        Shapes: ``track_ids`` (N,), ``covariances`` (N, 2, 2).
        """
        self._ids, self._sums = track_ids, covariances + self.covariances(track_ids)

    def return_to(self, track_ids: Ints, covariances: Floats) -> None:
        """Take the drifts of some tracks that were brought back to their points.

        Shapes: ``track_ids`` (N,), ``covariances`` (N, 2, 2).
        """
        _, at, of = np.intersect1d(self._ids, track_ids, assume_unique=True, return_indices=True)
        self._sums[at] = covariances[of]

    def covariances(self, track_ids: Ints) -> Floats:
        """Covariances of the drift.

        Shapes: ``track_ids`` (N,), returns (N, 2, 2).

        * Returns: In px^2; zero for tracks that are new, or that descriptors found.
        """
        drifts = np.zeros((len(track_ids), 2, 2))
        _, at, of = np.intersect1d(track_ids, self._ids, assume_unique=True, return_indices=True)
        drifts[at] = self._sums[of]
        return drifts
