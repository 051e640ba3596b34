"""Depths that somebody else measured or predicted: an RGB-D camera, a network, a map of another sensor."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from slam_init.errors import SlamInitError
from slam_init.types.arrays import Floats, Ints


class DepthKind(StrEnum):
    """What the values of a depth image are, up to which unknowns of each view."""

    #: Depths in metres.
    METRIC = "metric"
    #: Depths up to a scale.
    SCALE = "scale"
    #: Depths up to a scale and a shift.
    AFFINE = "affine"
    #: Inverse depths up to a scale and a shift, as most networks for single images give them.
    INVERSE = "inverse"


class TrackDepths(NamedTuple):
    """The depths of the tracks of a frame."""

    #: (N,) Strictly increasing.
    track_ids: Ints
    #: (N,) NaN where unknown.
    values: Floats
    #: (N,) Relative standard deviations.
    sigmas: Floats
    kind: DepthKind


@dataclass(frozen=True, eq=False)
class Depth:
    """Depths along the optical axis of one frame, from elsewhere.

    Attributes
    ----------
    values : (H, W) or (N,) float
        Those of an image of any resolution that shows what the frame shows, or those of the tracks of a frame in their
        order. Unknown are NaN, infinite ones and, but for ``inverse`` and ``affine``, those that are not positive.
    kind : DepthKind or str
        ``metric``, ``scale``, ``affine`` or ``inverse``.
    sigma : float or array of the shape of ``values``
        Relative standard deviation, with the errors that neighbouring pixels share. A confidence c in (0, 1] is given
        as ``sigma / c``.

    Raises
    ------
    SlamInitError
        If the shape, the kind or the sigma is none of these.
    """

    values: Floats
    kind: DepthKind | str = DepthKind.SCALE
    sigma: float | Floats = 0.1

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or self.kind not in tuple(DepthKind):
            raise SlamInitError(f"depth of the kind {self.kind!r:.60}: give {', '.join(DepthKind)}")
        try:
            values, sigma = np.asarray(self.values, float), np.asarray(self.sigma, float)
        except (TypeError, ValueError):
            values = sigma = np.zeros(())
        if values.ndim not in (1, 2) or (values.ndim == 2 and not values.size):
            raise SlamInitError("depth: give floats of shape (H, W), or (N,) for the tracks of a frame")
        if sigma.shape not in ((), values.shape) or (sigma <= 0).any() or (not sigma.ndim and not np.isfinite(sigma)):
            raise SlamInitError("sigma of a depth: give a positive number, or one for each value")

    def at(self, track_ids: Ints, pixels: Floats, size: tuple[int, int]) -> TrackDepths:
        """The depths of the tracks of a frame: those of the nearest pixels.

        Parameters
        ----------
        track_ids : (N,) int
        pixels : (N, 2) float
        size : (int, int)
            Width and height of the frame.

        Returns
        -------
        TrackDepths

        Raises
        ------
        SlamInitError
            If there is one value for each track, and their number is another one.
        """
        values, kind = np.asarray(self.values, float), DepthKind(self.kind)
        sigmas = np.broadcast_to(np.asarray(self.sigma, float), values.shape)
        if values.ndim == 2:
            # A sample between two pixels would mix the depths on both sides of an edge.
            places = np.floor((pixels + 0.5) * np.divide(values.shape[::-1], size)).astype(np.int64)
            column, row = np.clip(places, 0, np.subtract(values.shape[::-1], 1)).T
            values, sigmas = values[row, column], sigmas[row, column]
        elif len(values) != len(pixels):
            raise SlamInitError(f"depth has {len(values)} values for {len(pixels)} tracks: give one for each")
        known = np.isfinite(values) & np.isfinite(sigmas)
        if kind in (DepthKind.METRIC, DepthKind.SCALE):
            known &= values > 0
        return TrackDepths(track_ids, np.where(known, values, np.nan), sigmas, kind)
