"""The tracks of a window: which views and which tracks take part in the joint fit.

The errors of a tracker are not independent from view to view, as noise is. They are measured on rendered images of
cameras that only turn, with a wrong focal length or an unstated distortion. With a rolling shutter, an error of the
turning moves all rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from slam_init.frontend.rolling_shutter import corrected_pixels, readout_places, turning_flow
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.correlated_errors import orthonormal_polynomials
from slam_init.types.frame import Observations
from slam_init.types.inertial import RelativeRotation
from slam_init.types.lens import Lens
from slam_init.window.levels import LASTING_PX, LASTING_SHARE, SHARED_PX

#: A decision needs a well-spread subset of the tracks, not all of them: the standard deviation of the direction falls
#: with the square root of their number, and 300 of 800 tracks leave 1.6 times of it.
#: Class: budget.
MAX_TRACKS = 300
#: The information of more views comes from their baselines, which grow; views in between add little.
#: Class: budget.
MAX_VIEWS = 12
#: A blurred corner is a trail, and a tracker follows some point of it: one instant of the exposure. On rendered images
#: the standard deviation of this instant is 0.12 to 0.15 exposures.
#: Class: measured, in exposures.
_INSTANT = 0.15
#: The image is divided into this many cells (columns, rows); each cell gives its best tracks in turn.
_CELLS = (12, 9)

#: Of a measured rotation between two views: no gyroscope is better than a thousandth of a degree.
#: Class: assumption, in rad^2.
_LEAST_VARIANCE_RAD2 = 3e-10


#: Arrays (V, T, ...) and arrays (V, ...) of :class:`WindowTracks`.
_OF_OBSERVATIONS = ("pixels", "seen", "sigma_px", "whitening", "places", "sweep_px_s")
_OF_VIEWS = ("sweep_errors", "times_s", "turned", "turned_weights")


@dataclass(frozen=True, eq=False)
class WindowTracks:
    """The tracks of a window."""

    #: With the current lens, which is the stated one of a calibrated camera.
    camera: Camera
    #: Absolute indices, in any order; the frame of the first view is the world.
    frames: tuple[int, ...]
    #: (T,)
    track_ids: Ints
    #: (V, T, 2) Raw pixels, corrected for the readout; any number where a view does not see a track.
    pixels: Floats
    #: (V, T)
    seen: Bools
    #: (T, 3) Unit bearings in the anchor views, by the camera with the current lens; the axis where there is none.
    rays: Floats
    #: (T,) First view that sees a track; -1 for a track that fewer than two views see.
    anchor: Ints
    #: (V, T) Standard deviation of a pixel in the direction in which it is best known.
    sigma_px: Floats
    #: (V, T, 2, 2) Makes the noise of a pixel, in units of sigma_px, equal in all directions; symmetric with a
    #: largest eigenvalue of 1.
    whitening: Floats
    #: (V, T, 6) Six polynomials of degree two or less, orthonormal over the image, at the pixels; over sigma_px.
    places: Floats
    #: (V, T, 2) Derivatives of the raw pixels by the readout of a rolling shutter.
    sweep_px_s: Floats
    #: (V,) Relative standard deviations of the sweeps of each view.
    sweep_errors: Floats
    #: Readout that the pixels are corrected for.
    readout_s: float
    #: (V,) Time stamps of the views.
    times_s: Floats
    #: Lower limit of :attr:`noise_px`: what the tracker can measure, and how far it drifts.
    least_noise_px: float
    #: (V, 3, 3) Measured rotations of the views from the first view; any where there is no measurement.
    turned: Floats
    #: (V,) One over the variances of these rotations, rad^-2; 0 where there is no measurement.
    turned_weights: Floats

    def __post_init__(self) -> None:
        # The loops are compiled for each layout of an array: some seconds, where a choice of tracks transposes one.
        for name in (*_OF_OBSERVATIONS, *_OF_VIEWS, "rays", "anchor"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name)))

    @staticmethod
    def gather(
        camera: Camera,
        frames: tuple[int, ...],
        track_ids: Ints,
        pixels: Floats,
        seen: Bools,
        noise_px: float,
        least_noise_px: float = 0.0,
        drifts: Floats | None = None,
    ) -> WindowTracks:
        """Prepare tracks of a global shutter for the fit, without measured rotations.

        Shapes: ``track_ids`` (T,), ``pixels`` (V, T, 2), ``seen`` (V, T), ``drifts`` (V, T, 2, 2).

        * ``noise_px``: Standard deviation of a coordinate of a pixel, of the median observation.
        * ``least_noise_px``: Lower limit of the standard deviation of a coordinate of a pixel.
        * ``drifts``: Covariances of the drifts since the anchor views, px^2; by default none. With the lower limit they
          are the least that the noise can be; where it is larger, it is so by one factor.
        """
        rays, anchor = _rays_of_anchors(camera, pixels, seen)
        sigma_px, whitening = np.full(seen.shape, float(noise_px)), np.broadcast_to(np.eye(2), (*seen.shape, 2, 2))
        if drifts is not None and seen.any():
            sigma_px, whitening, least_noise_px = _noise_with_drifts(seen, noise_px, least_noise_px, drifts)
        places = orthonormal_polynomials(camera, np.where(seen[..., None], pixels, 0.0)) / sigma_px[..., None]
        return WindowTracks(
            camera,
            frames,
            track_ids,
            np.nan_to_num(pixels),
            seen,
            rays,
            anchor,
            sigma_px,
            whitening,
            places,
            sweep_px_s=np.zeros((*seen.shape, 2)),
            sweep_errors=np.zeros(len(seen)),
            readout_s=0.0,
            times_s=np.zeros(len(seen)),
            least_noise_px=least_noise_px,
            turned=np.tile(np.eye(3), (len(seen), 1, 1)),
            turned_weights=np.zeros(len(seen)),
        )

    @cached_property
    def noise_px(self) -> float:
        """Standard deviation of a coordinate of a pixel: the median of the observations."""
        return float(np.median(self.sigma_px[self.seen])) if self.seen.any() else float(np.median(self.sigma_px))

    @cached_property
    def residual_px(self) -> float:
        """Standard deviation of a coordinate of a residual: the median of the observations beyond the anchor views."""
        beyond = self.seen & (np.arange(len(self.seen))[:, None] > self.anchor)
        return float(np.median(self.sigma_px[beyond])) if beyond.any() else self.noise_px

    def bearings(self, lens: Lens) -> Floats:
        """The measured rays.

        Shapes: returns (V, T, 3).

        * ``lens``: Beside ``camera``.
        * Returns: Unit rays in the cameras; NaN where a view does not see a track.
        """
        rays = self._rays_of(self.pixels, self.sweep_px_s, lens)
        rays[~self.seen] = np.nan
        return rays

    def anchor_rays(self, lens: Lens) -> Floats:
        """The measured rays in the anchor views, see :meth:`bearings`.

        Shapes: returns (T, 3).
        """
        at = (np.maximum(self.anchor, 0)[None], np.arange(len(self.anchor))[None])
        return np.asarray(self._rays_of(self.pixels[at], self.sweep_px_s[at], lens)[0])

    def _rays_of(self, pixels: Floats, sweep_px_s: Floats, lens: Lens) -> Floats:
        centre = np.array([self.camera.cx, self.camera.cy])
        moved = pixels - np.array(lens.principal_px)
        if lens.readout_s != self.readout_s:
            moved -= (lens.readout_s - self.readout_s) * sweep_px_s
        moved = centre + (moved - centre) / np.exp(lens.log_scale) if lens.log_scale else moved
        return self.camera.bent(lens.k1).bearings(moved).reshape(*moved.shape[:-1], 3)

    def with_noise(self, noise_px: float) -> WindowTracks:
        """The same tracks with another noise."""
        factor = noise_px / self.noise_px
        return replace(self, sigma_px=self.sigma_px * factor, places=self.places / factor)

    def of_views(self, rows: tuple[int, ...]) -> WindowTracks:
        """The same tracks in some of the views."""
        if rows == tuple(range(len(self.frames))):
            return self
        arrays: dict[str, Any] = {name: getattr(self, name)[list(rows)] for name in (*_OF_OBSERVATIONS, *_OF_VIEWS)}
        rays, anchor = _rays_of_anchors(self.camera, arrays["pixels"], arrays["seen"])
        # The rotations are measured from the first view.
        arrays["turned_weights"] *= rows[0] == 0
        return replace(self, frames=tuple(self.frames[row] for row in rows), rays=rays, anchor=anchor, **arrays)

    def of_tracks(self, chosen: Ints) -> WindowTracks:
        """Some of the tracks in the same views.

        Shapes: ``chosen`` (N,).
        """
        arrays: dict[str, Any] = {name: getattr(self, name)[:, chosen] for name in _OF_OBSERVATIONS}
        arrays |= {name: getattr(self, name)[chosen] for name in ("track_ids", "rays", "anchor")}
        return replace(self, **arrays)


def gather_tracks(
    camera: Camera,
    views: Sequence[Observations],
    noise_px: float,
    least_noise_px: float = 0.1,
    measured: Sequence[RelativeRotation | None] = (),
) -> WindowTracks:
    """Choose tracks that are seen in many views and spread over the image.

    * ``views``: The pair first (reference, current), then further views in any order.
    """
    track_ids, pixels, seen, rows = _table(camera, views)
    # A track of both views of the pair binds all views to the pair.
    score = seen.sum(axis=0) + len(views) * (seen[0] & seen[1])
    chosen = _spread(camera, pixels, seen, score)
    pixels, seen, rows = pixels[:, chosen], seen[:, chosen], rows[:, chosen]
    sweep_px_s, drifts, slides_px = _motion_of_pixels(camera, views, seen, rows)
    since_anchor = _since_anchor(seen, drifts, slides_px) if drifts.any() or slides_px.any() else None
    frames, noise_px = tuple(view.frame for view in views), max(noise_px, 1e-3)
    tracks = WindowTracks.gather(
        camera, frames, track_ids[chosen], pixels, seen, noise_px, least_noise_px, since_anchor
    )
    turned, turned_weights = _turned_from_first(measured or [None] * len(views))
    return replace(
        tracks,
        sweep_px_s=np.nan_to_num(sweep_px_s),
        sweep_errors=np.array([view.turn_error for view in views]),
        # Views whose turning is not known are not corrected for the readout.
        readout_s=next((view.readout_s for view in views if view.turn_rad_s is not None), 0.0),
        times_s=np.array([view.timestamp_s for view in views]),
        turned=turned,
        turned_weights=turned_weights,
    )


def _rays_of_anchors(camera: Camera, pixels: Floats, seen: Bools) -> tuple[Floats, Ints]:
    """The rays (T, 3) in the anchor views, and these views (T,); see :class:`WindowTracks`."""
    anchor = np.where(seen.sum(axis=0) >= 2, np.argmax(seen, axis=0), -1).astype(np.int64)
    rays = camera.bearings(pixels[np.maximum(anchor, 0), np.arange(pixels.shape[1])])
    has_ray = np.isfinite(rays).all(axis=1)
    anchor[~has_ray] = -1
    # A fisheye has no ray for a corner of its image, where a track lies that no view sees. A ray of zero length
    # would become NaN with the first step, and the places of all tracks with it.
    rays[~has_ray] = (0.0, 0.0, 1.0)
    return rays, anchor


def _noise_with_drifts(
    seen: Bools, noise_px: float, least_noise_px: float, drifts: Floats
) -> tuple[Floats, Floats, float]:
    """Noise of the pixels with drifts (V, T, 2, 2): sigma_px (V, T), whitening (V, T, 2, 2), the median least noise."""
    variances, axes = _principal_axes(drifts)
    sigmas_px = np.hypot(np.sqrt(np.maximum(variances, 0.0)), least_noise_px)
    least_noise_px = float(np.median(sigmas_px[seen, 0]))
    sigma_px = np.where(seen, sigmas_px[..., 0], least_noise_px) * max(noise_px / least_noise_px, 1.0)
    whitening = np.einsum("...ij,...j,...kj->...ik", axes, sigmas_px[..., :1] / sigmas_px, axes)
    return sigma_px, whitening, least_noise_px


def _turned_from_first(measured: Sequence[RelativeRotation | None]) -> tuple[Floats, Floats]:
    """Measured rotations (V, 3, 3) of the views from the first one, and one over their variances (V,)."""
    turned, weights = np.tile(np.eye(3), (len(measured), 1, 1)), np.zeros(len(measured))
    first = measured[0]
    for k, one in enumerate(measured):
        if k and first is not None and one is not None and one.start == first.start:
            turned[k] = one.cam_from_start @ first.cam_from_start.T
            weights[k] = 1 / max(abs(one.variance_rad2 - first.variance_rad2), _LEAST_VARIANCE_RAD2)
    return turned, weights


def _table(camera: Camera, views: Sequence[Observations]) -> tuple[Ints, Floats, Bools, Ints]:
    """The tracks that two views or more see: ids (T,), pixels (V, T, 2), visibility and row in the view (V, T)."""
    track_ids, counts = np.unique(np.concatenate([view.track_ids for view in views]), return_counts=True)
    track_ids = track_ids[counts >= 2]
    pixels = np.zeros((len(views), len(track_ids), 2))
    seen = np.zeros((len(views), len(track_ids)), bool)
    rows = np.zeros(seen.shape, np.int64)
    for k, view in enumerate(views if len(track_ids) else ()):
        at = np.minimum(np.searchsorted(track_ids, view.track_ids), len(track_ids) - 1)
        of = np.flatnonzero(track_ids[at] == view.track_ids)
        pixels[k, at[of]], seen[k, at[of]], rows[k, at[of]] = corrected_pixels(camera, view)[of], True, of
    return track_ids, pixels, seen, rows


def _motion_of_pixels(
    camera: Camera, views: Sequence[Observations], seen: Bools, rows: Ints
) -> tuple[Floats, Floats, Floats]:
    """Sweeps (V, T, 2), drifts (V, T, 2, 2) and slides (V, T, 2) of the tracks; 0 where a view does not see one."""
    sweep_px_s, slides_px = np.zeros((*seen.shape, 2)), np.zeros((*seen.shape, 2))
    drifts = np.zeros((*seen.shape, 2, 2))
    for k, view in enumerate(views):
        if len(view.drifts):
            drifts[k, seen[k]] = view.drifts[rows[k, seen[k]]]
    turning = [k for k, view in enumerate(views) if view.turn_rad_s is not None]
    at = seen & np.isin(np.arange(len(views)), turning)[:, None]
    if at.any():
        # All views at once: a projection of some hundred rays takes as long as one of some thousand.
        rays = np.concatenate([views[k].bearings[rows[k, seen[k]]] for k in turning])
        pixels = np.concatenate([views[k].pixels[rows[k, seen[k]]] for k in turning])
        turns = np.array([np.zeros(3) if view.turn_rad_s is None else view.turn_rad_s for view in views])
        of_view = np.nonzero(at)[0]
        flow_px_s = turning_flow(camera, rays, turns[of_view])
        sweep_px_s[at] = flow_px_s * readout_places(camera, pixels)[:, None]
        slides_px[at] = _INSTANT * np.array([view.exposure_s for view in views])[of_view, None] * flow_px_s
    return sweep_px_s, drifts, slides_px


def _since_anchor(seen: Bools, drifts: Floats, slides_px: Floats) -> Floats:
    """Covariances (V, T, 2, 2) of the drifts between the anchor view and each view."""
    anchor = np.argmax(seen, axis=0)
    between = drifts - drifts[anchor, np.arange(seen.shape[1])]
    # A track that keeps its instant slides where the motion changes.
    slides_px = np.where(seen[..., None], slides_px - slides_px[anchor, np.arange(seen.shape[1])], 0.0)
    # A view that is earlier than the anchor has drifted less. Where descriptors found a track, its drift began again.
    # The errors of two alignments do not add up, so that their difference is too small. On clear images both are below
    # the least noise.
    variances, axes = _principal_axes(np.where(seen[..., None, None], between, 0.0))
    of_tracker = (axes * np.abs(variances)[..., None, :]) @ np.swapaxes(axes, -1, -2)
    return np.asarray(of_tracker + slides_px[..., :, None] * slides_px[..., None, :])


def _principal_axes(covariances: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (..., 2), the smaller first, and eigenvectors (..., 2, 2) as columns of symmetric matrices.

    The closed form is six times as fast as a call of LAPACK for each of some thousand matrices.
    """
    a, b, c = covariances[..., 0, 0], covariances[..., 0, 1], covariances[..., 1, 1]
    middle, radius = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    angle = 0.5 * np.arctan2(2 * b, a - c)
    cosine, sine = np.cos(angle), np.sin(angle)
    axes = np.stack([np.stack([-sine, cosine], axis=-1), np.stack([cosine, sine], axis=-1)], axis=-1)
    return np.stack([middle - radius, middle + radius], axis=-1), axes


def _spread(camera: Camera, pixels: Floats, seen: Bools, score: Ints) -> Ints:
    """Positions (ascending) of some tracks: the best of each cell, then the second of each cell, and so on."""
    count = pixels.shape[1]
    if count <= MAX_TRACKS:
        return np.arange(count)
    first = pixels[np.argmax(seen, axis=0), np.arange(count)]
    columns, rows = (np.clip(first / (camera.width, camera.height), 0, 0.999) * _CELLS).astype(int).T
    cell = columns * _CELLS[1] + rows
    order = np.lexsort((np.arange(count), -score, cell))
    starts = np.concatenate([[True], np.diff(cell[order]) != 0])
    run = np.arange(count) - np.maximum.accumulate(np.where(starts, np.arange(count), 0))
    rank = np.empty(count, np.int64)
    rank[order] = run
    return np.sort(np.lexsort((np.arange(count), -score, rank))[:MAX_TRACKS])


# -- what errors of the tracks gain for a translation where the camera only rotates ------------------------------------


def gain_of_lasting_errors(tracks: WindowTracks, R: Floats) -> float:
    """Factor on what a translation gains by chance, for errors that the tracker keeps from view to view.

    Shapes: ``R`` (V, 3, 3).
    """
    cosines = (np.trace(R, axis1=1, axis2=2) - 1) / 2
    displacement_px = tracks.camera.focal_px * float(np.arccos(np.clip(cosines, -1.0, 1.0)).max())
    return 1 + (min(LASTING_SHARE * displacement_px, LASTING_PX) / tracks.residual_px) ** 2


def with_lasting_errors(tracks: WindowTracks, R: Floats) -> WindowTracks:
    """The tracks with the errors that the tracker keeps in the noise.

    Shapes: ``R`` (V, 3, 3).
    """
    noise_px = tracks.noise_px * math.sqrt(gain_of_lasting_errors(tracks, R))
    return replace(tracks.with_noise(noise_px), least_noise_px=noise_px)


def gain_of_shared_errors(tracks: WindowTracks) -> float:
    """Sum of the squares, in units of the noise, of errors that the tracks of a view share."""
    return float(tracks.seen[:, tracks.anchor >= 0].sum()) * (SHARED_PX / tracks.residual_px) ** 2


def gain_of_turning_errors(tracks: WindowTracks, readout_s: float) -> float:
    """Sum of the squares, in units of the noise, of what a rolling shutter moves by errors of the turning."""
    moved_px = readout_s * tracks.sweep_errors[:, None] * np.linalg.norm(tracks.sweep_px_s, axis=2)
    seen = tracks.seen & (tracks.anchor >= 0)
    return float(np.sum((moved_px[seen] / tracks.sigma_px[seen]) ** 2))
