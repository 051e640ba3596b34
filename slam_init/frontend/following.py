"""The tracks of a frame in the next one: by their patches where their places are known closely, else by flow.

Most of the time of the flow is spent at each point in each octave of the images, there and back. So a few points are
followed through all octaves. They show whether all move as in the step before, but for a shift that all have in common,
as when the camera turns more or less (:func:`expected_as_before`):

* to half a pixel: the patch of each track is aligned from where it is expected. One that is found there needs no flow.
* to some pixels: the flow seeks the points near their places, in the finest two octaves.
* else: the flow seeks them in all octaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_init.config import TrackingConfig
from slam_init.frontend.flow import Flow, flow
from slam_init.frontend.patches import Patches, Sought
from slam_init.types.arrays import Floats, Image, evenly_spaced
from slam_init.types.frame import Observations

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
class Expected:
    """Where points are expected in the next frame."""

    #: (N, 2) NaN where no step is known.
    pixels: Floats
    #: Whether most points are close to their places.
    closely: bool
    #: The flow of the few points that show it.
    few: Flow


@dataclass(frozen=True, eq=False)
class Followed:
    """The tracks of a frame in the next one."""

    flow: Flow
    #: Of the same tracks: the patches that were found without flow.
    sought: Sought


def follow(
    before: Image,
    after: Image,
    smooth: Image,
    last: Observations,
    moved: Floats,
    patches: Patches,
    config: TrackingConfig,
) -> Followed:
    """Follow the tracks of a frame into the next one.

    Shapes: ``before, after, smooth`` (H, W), ``moved`` (N, 2).

    * ``smooth``: The next frame, :func:`~slam_init.frontend.patches.smoothed`.
    * ``moved``: By how much each track moved in the step before; NaN where that is not known.
    """
    pixels = last.pixels
    expected = expected_as_before(before, after, pixels, moved, config)
    if expected is None or not expected.closely:
        found = flow(before, after, pixels, config, None if expected is None else expected.pixels)
        return Followed(found, Sought.nowhere(len(pixels)))
    sought = patches.seek(smooth, last.track_ids, expected.pixels).within(_CLOSE_PX, expected.pixels)
    # The few points show the blur as all points do. What is stated of a patch that is found replaces the rest.
    unknown, few = np.tile(np.eye(2), (len(pixels), 1, 1)), expected.few
    found = Flow(sought.found, sought.pixels.copy(), unknown, np.zeros(len(pixels)), few.trail, few.step_px)
    others = np.flatnonzero(~sought.found)
    found.put(others, flow(before, after, pixels[others], config, expected.pixels[others]))
    return Followed(found, sought)


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
