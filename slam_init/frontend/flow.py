"""Lucas-Kanade flow from one frame to the next, and the tracks of a frame in the next one.

The flow minimizes the difference of two image patches. To first order, the covariance of its displacement is
``sigma_I^2 G^-1``: ``sigma_I`` is what remains of the difference, and ``G`` the sum of the products of the gradients
over the patch. Blur lowers the gradients along the motion, so that a track slides along its trail; a flicker, an
occlusion or a reflection raises the remainder. The next step starts where the last one ended. So the covariances of the
steps add up: this is the drift of a track, until its patch brings it back to its point
(:mod:`~slam_init.frontend.patches`).

On rendered images with up to 16 px of blur, the errors of a step are 0.6 to 1.1 times these standard deviations (see
``_SCALE``) in the weak direction and in the strong one alike, while they themselves grow four times; beyond 16 px of
blur 1.3 and 1.8 times.

Most of the time of the flow is spent at each point in each octave of the images, there and back. So a few points are
followed through all octaves. They show whether all move as in the step before, but for a shift that all have in common,
as when the camera turns more or less (:func:`expected_as_before`):

* to half a pixel: the patch of each track is aligned from where it is expected. One that is found there needs no flow.
* to some pixels: the flow seeks the points near their places, in the finest two octaves.
* else: the flow seeks them in all octaves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slam_init.config import TrackingConfig
from slam_init.frontend.patches import MISFIT_PX, Patches, Sought, anisotropy
from slam_init.frontend.sift import first_per_cell
from slam_init.types.arrays import Bools, Floats, Floats32, Image, Ints, evenly_spaced
from slam_init.types.frame import Observations

#: Standard deviation of a step over the mean absolute difference of the patches by the root of the mean squared
#: gradient, measured on rendered images. With independent errors of the pixels it would be 0.06: 1.25 over the root of
#: 441 pixels.
_SCALE = 0.13
#: A trail of L px lowers the mean squared gradient along it to a share of 1 / (1 + L / 7) of that across it: on
#: rendered images to 0.62 at 4.7 px, 0.43 at 9.5 px, 0.37 at 15 px.
_SHARP_PX = 7.0
#: Trails are measured where most points move by more than this between two frames: shorter ones look like corners.
_LEAST_MOTION_PX = 8.0
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
#: Points that show whether all move as before: a twentieth of all. Fewer than half of them give no share.
_SAMPLES, _LEAST_SAMPLES = 48, 24
#: Points are near where they are expected within this distance, px: half of what the window of the flow reaches from
#: its centre in the finest octave, so that the octave above it finds them in any case.
_NEAR_PX = 5.0
#: The other points are sought near their places where this share of the few are found near theirs: some few are lost,
#: or lie on a moving object.
_NEAR_SHARE = 0.8
#: An alignment that begins this close to the place, px, mostly ends there: on four videos 0 to 3 % of the tracks end
#: elsewhere from up to half a pixel, and 1 to 14 % from half a pixel to one.
_CLOSE_PX = 0.5
#: Patches are sought where this share of the few are that close to where they are expected. Where more are elsewhere,
#: many alignments begin too far away, and most tracks need the flow besides.
_CLOSE_SHARE = 2 / 3


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
    from slam_init.frontend.patch_kernel import sums_of_products

    radius = window_px // (2 * _STEP_PX)
    last = (np.array(image.shape) - 1) // _STEP_PX
    centres = np.clip(np.round(pixels[:, ::-1] / _STEP_PX).astype(int), 0, last)
    # The loop is compiled for arrays like most images: of one piece, and not read-only.
    sums = sums_of_products(np.require(image, requirements=["C", "W"]), centres, radius, _STEP_PX)
    # Gradients are eight times the slope.
    xx, xy, yy = (sums.T / 64 * (1 / (2 * radius + 1) ** 2)).astype(np.float32).astype(float)
    return np.stack([np.stack([xx + _ROUNDING, xy], axis=1), np.stack([xy, yy + _ROUNDING], axis=1)], axis=1)


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


class Expected(NamedTuple):
    """Where points are expected in the next frame."""

    #: (N, 2) NaN where no step is known.
    pixels: Floats
    #: Whether most points are close to their places.
    closely: bool
    #: The flow of the few points that show it.
    few: Flow


def follow(
    before: Image,
    after: Image,
    smooth: Image,
    last: Observations,
    moved: Floats,
    patches: Patches,
    config: TrackingConfig,
) -> tuple[Flow, Sought | None]:
    """Follow the tracks of a frame into the next one.

    Shapes: ``before, after, smooth`` (H, W), ``moved`` (N, 2).

    * ``smooth``: The next frame, :func:`~slam_init.frontend.patches.smoothed`.
    * ``moved``: By how much each track moved in the step before; NaN where that is not known.
    * Returns: The flow, and the patches that were found without it.
    """
    pixels = last.pixels
    expected = expected_as_before(before, after, pixels, moved, config)
    if expected is None or not expected.closely:
        return flow(before, after, pixels, config, None if expected is None else expected.pixels), None
    sought = patches.seek(smooth, last.track_ids, expected.pixels)
    near = sought.found & (np.linalg.norm(sought.pixels - expected.pixels, axis=1) <= _CLOSE_PX)
    sought.residuals[~near] = np.inf
    # The few points show the blur as all points do. What is stated of a patch that is found replaces the rest.
    unknown, few = np.tile(np.eye(2), (len(pixels), 1, 1)), expected.few
    found = Flow(near, sought.pixels.copy(), unknown, np.zeros(len(pixels)), few.trail, few.step_px)
    others = np.flatnonzero(~near)
    found.put(others, flow(before, after, pixels[others], config, expected.pixels[others]))
    return found, sought


def expected_as_before(
    before: Image, after: Image, pixels: Floats, moved: Floats, config: TrackingConfig
) -> Expected | None:
    """Where points are expected that move as in the step before, but for a shift that all have in common.

    A few points are sought in all octaves. They show the shift, by which the camera turns more or less than before.

    Shapes: ``before, after`` (H, W), ``pixels, moved`` (N, 2).

    * ``moved``: By how much each point moved in the step before; NaN where that is not known.
    * Returns: None where a fifth of the few points are not near their places, or where too few steps are known.
    """
    known = np.flatnonzero(np.isfinite(moved).all(axis=1))
    if len(known) < _LEAST_SAMPLES:
        return None
    chosen = known[evenly_spaced(len(known), _SAMPLES)]
    few = flow(before, after, pixels[chosen], config, and_back=False)
    more = (few.pixels - pixels[chosen] - moved[chosen])[few.kept]
    shift = np.median(more, axis=0) if len(more) else np.zeros(2)
    misses_px = np.linalg.norm(more - shift, axis=1)
    if (misses_px <= _NEAR_PX).sum() < _NEAR_SHARE * len(chosen):
        return None
    closely = (misses_px <= _CLOSE_PX).sum() >= _CLOSE_SHARE * len(chosen)
    return Expected(pixels + moved + shift, bool(closely), few)
