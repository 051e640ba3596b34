"""The hypothesis that the camera only rotates, with a lens that zooms and an image that shifts from view to view.

A lens that focuses changes the focal length of each view by up to some hundredths. That looks like a motion toward a
plane. A stabilizer shifts the image of each view by up to a hundredth of its width. That looks like a motion along a
plane. So a map has to gain over this camera too. Rotations, zooms and shifts are fitted jointly, with the priors of
zooms and shifts. The start of a view whose zoom is large is the similarity that most tracks agree on.

In the comparison zooms ``z`` and shifts ``s`` are undone in the pixels, ``c + (x - s - c) / (1 + z)``, and the noise is
that of the pixels as measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from quest.algebra import turn
from slam_init.types.arrays import Floats, evenly_spaced
from slam_init.types.camera import Camera
from slam_init.types.lens import Lens
from slam_init.window.arguments import ZOOM_TERMS, Limits
from slam_init.window.hypotheses import WindowHypotheses, approached, rotating
from slam_init.window.joint_fit import fit_window
from slam_init.window.levels import LARGEST_ZOOM, SHIFTS, ZOOM_LEAVES, ZOOMED_COST
from slam_init.window.state import Priors, WindowState
from slam_init.window.tracks import WindowTracks

#: Standard deviation of the logarithm of the focal length of a reference before which a person may have zoomed.
#: Class: assumption.
_REFERENCE_ZOOM = 0.3
#: A similarity by two tracks is tried so often: where two fifths of the tracks are at rest, all fail once in 70 000
#: times. So many tracks vote. The two tracks lie this far apart, over the width of the image. No view is zoomed by more
#: than this factor.
_SIMILARITIES, _SIMILAR_TRACKS, _LEAST_APART, _LARGEST_FACTOR = 64, 100, 0.1, 3.0
#: Views that are nearer in time count as this far apart.
_LEAST_SPAN_S = 1e-3
#: From coordinates to complex numbers.
_COMPLEX = np.array([1, 1j])
#: Fewer tracks than this do not locate a view: twice its four unknowns, at two coordinates a track.
_LEAST_TRACKS = 4


@dataclass(frozen=True, eq=False)
class ZoomingRotation:
    """A camera that rotates, and whose images zoom and shift from view to view."""

    #: Those of the window with this camera in place of the one that only rotates, and both undone in the tracks. The
    #: cost of the camera has the price of the zooms and the shifts.
    hypotheses: WindowHypotheses
    #: (V,) Of the views of the window.
    zooms: Floats
    #: (V, 2) In pixels.
    shifts: Floats
    #: What both cost, in twice the nats.
    price: float = 0.0

    def errors_px(self, tracks: WindowTracks, priors: Priors) -> Floats:
        """What the model of the zooms leaves of their displacements (V, T): standard deviations of the tracks.

        The distortion changes with the focus, and the rows of an image are zoomed one after another.
        """
        order = np.argsort(tracks.times_s, kind="stable")
        spans_s = np.maximum(np.diff(tracks.times_s[order]), _LEAST_SPAN_S)
        rates = np.abs(np.diff(np.log1p(self.zooms[order]))) / spans_s
        rates = np.maximum(np.append(rates, 0.0), np.append(0.0, rates))[np.argsort(order, kind="stable")]
        readout_s = max(abs(tracks.readout_s), priors.readout_sigma_s)
        of_views = np.hypot(ZOOM_LEAVES * self.zooms, 0.5 * readout_s * rates)
        of_both = np.hypot(of_views[:, None], of_views[np.maximum(tracks.anchor, 0)])
        return np.asarray(of_both * np.linalg.norm(tracks.pixels - _centre(tracks.camera), axis=2))

    def beside(self, hypotheses: WindowHypotheses) -> ZoomingRotation:
        """The camera beside hypotheses of tracks with another noise, fitted to these from where it is."""
        fit = self.hypotheses.rotation_only
        return _fitted(hypotheses, fit.state, self.zooms, self.shifts, fit.priors)


def with_zooms(hypotheses: WindowHypotheses) -> ZoomingRotation:
    """Let the images of the camera that only rotates zoom and shift from view to view."""
    tracks, R = hypotheses.tracks, hypotheses.rotation_only.state.R
    # A readout would take the place of zooms, so it is that of the best motion.
    priors = replace(hypotheses.priors, readout_sigma_s=0.0)
    lens, none = Lens(readout_s=hypotheses.motions[0].fit.state.lens.readout_s), np.zeros((len(R), 2))
    R, zooms = _located(tracks, R, lens)
    found = _fitted(hypotheses, rotating(zoomed(tracks, zooms), R, lens), zooms, none, priors)
    gains = found.hypotheses.rotation_only.cost < hypotheses.rotation_only.cost
    return found if gains else ZoomingRotation(hypotheses, none[:, 0], none)


def _fitted(
    hypotheses: WindowHypotheses, state: WindowState, zooms: Floats, shifts: Floats, priors: Priors
) -> ZoomingRotation:
    """Fit rotations, zooms and shifts jointly.

    * ``state``: Its rotations, rays and lens are the start.
    """
    tracks, shift_px = hypotheses.tracks, SHIFTS[-1][0] * hypotheses.tracks.camera.width
    # A person zooms by any factor, also before the reference.
    by_person = replace(
        priors,
        focal_sigma=max(priors.focal_sigma, _REFERENCE_ZOOM),
        zoom_sigma=math.log(_LARGEST_FACTOR),
        shift_sigma_px=shift_px,
    )
    field = np.zeros_like(state.field)
    field[:, 0], field[:, 1:ZOOM_TERMS] = np.log1p(zooms), shifts
    near = approached(tracks, replace(state, field=field), by_person)
    focuses = _cost_of_zooms(_zooms_and_shifts(near)[0]) < ZOOMED_COST
    priors = replace(by_person, focal_sigma=priors.focal_sigma, zoom_sigma=LARGEST_ZOOM) if focuses else by_person
    state = fit_window(tracks, near, priors, rotation_only=True).state
    zooms, shifts = _zooms_and_shifts(state)
    price = min(_cost_of_zooms(zooms), ZOOMED_COST) + float(np.sum((shifts / shift_px) ** 2))
    # The image zooms about the principal point, as far as that is known.
    part = zoomed(tracks, zooms, shifts - zooms[:, None] * np.array(state.lens.principal_px))
    undone, priors = replace(state, field=np.zeros_like(state.field)), replace(priors, zoom_sigma=0.0)
    fit = fit_window(part, undone, priors, rotation_only=True, limits=Limits(max_steps=0))
    fit = replace(fit, cost=fit.cost + price)
    return ZoomingRotation(replace(hypotheses, tracks=part, rotation_only=fit), zooms, shifts, price)


def _cost_of_zooms(zooms: Floats) -> float:
    """What the zooms of a lens that focuses cost, in twice the nats."""
    return float(np.sum((zooms / LARGEST_ZOOM) ** 2))


def _zooms_and_shifts(state: WindowState) -> tuple[Floats, Floats]:
    """The zooms (V,) and the shifts (V, 2) of the views of a state."""
    return np.expm1(state.field[:, 0]), state.field[:, 1:ZOOM_TERMS].copy()


def zoomed(tracks: WindowTracks, zooms: Floats, shifts: Floats | None = None) -> WindowTracks:
    """The tracks with the zooms and the shifts of the views undone.

    Shapes: ``zooms`` (V,), ``shifts`` (V, 2).
    """
    factors, shifts = 1 + zooms, np.zeros((len(zooms), 2)) if shifts is None else shifts
    centre = _centre(tracks.camera)
    pixels = centre + (tracks.pixels - shifts[:, None] - centre) / factors[:, None, None]
    return replace(
        tracks,
        pixels=pixels,
        sigma_px=tracks.sigma_px / factors[:, None],
        places=tracks.places * factors[:, None, None],
        sweep_px_s=tracks.sweep_px_s / factors[:, None, None],
    )


def _centre(camera: Camera) -> Floats:
    return np.array([camera.cx, camera.cy])


def _located(tracks: WindowTracks, R: Floats, lens: Lens) -> tuple[Floats, Floats]:
    """The rotations (V, 3, 3) and the zooms (V,) of the views, one view after another.

    A view turns as it did without zooms, or as the similarity with the most agreeing tracks says.

    Shapes: ``R`` (V, 3, 3).
    """
    camera = tracks.camera.refocused(lens.log_scale, lens.k1)
    R, zooms, anchor, centre = R.copy(), np.zeros(len(R)), np.maximum(tracks.anchor, 0), _centre(tracks.camera)
    at_anchor = tracks.pixels[anchor, np.arange(len(anchor))]
    for k in range(1, len(R)):
        used = tracks.seen[k] & (tracks.anchor >= 0) & (tracks.anchor < k)
        undone = centre + (at_anchor - centre) / (1 + zooms[anchor])[:, None]
        from_anchor = camera.bearings(undone)
        used &= np.isfinite(from_anchor).all(axis=1)
        if used.sum() >= _LEAST_TRACKS:
            world = np.einsum("tji,tj->ti", R[anchor[used]], from_anchor[used])
            pixels = tracks.pixels[k, used]
            # Without zooms, the rotation of a view that is zoomed by much is any.
            nearest = min(range(k), key=lambda row: abs(tracks.frames[row] - tracks.frames[k]))
            starts = (R[k], 0.0), _similar(camera, world, pixels, R[nearest])
            R[k], zooms[k] = min(starts, key=lambda one: _median_px(camera, world, pixels, *one))
    return R, zooms


def _median_px(camera: Camera, world: Floats, pixels: Floats, R: Floats, zoom: float) -> float:
    """How far pixels (N, 2) are from those of rays of the world (N, 3) in a view that zooms, by their median."""
    centre = _centre(camera)
    projected = centre + (1 + zoom) * (camera.project(world @ R.T) - centre)
    return float(np.median(np.nan_to_num(np.linalg.norm(pixels - projected, axis=1), nan=math.inf)))


def _similar(camera: Camera, world: Floats, pixels: Floats, R: Floats) -> tuple[Floats, float]:
    """The rotation and the zoom of a view by the similarity of pixels with the least median of residuals.

    Two tracks determine a similarity: a zoom, a turn about the optical axis, and a shift, which stands for the rest of
    the rotation.
    """
    few = evenly_spaced(len(world), _SIMILAR_TRACKS)
    world, pixels = world[few], pixels[few]
    before = (camera.project(world @ R.T) - _centre(camera)) @ _COMPLEX
    after = (pixels - _centre(camera)) @ _COMPLEX
    random = np.random.default_rng(0)
    first, second = random.integers(0, len(before), (2, _SIMILARITIES))
    apart = before[second] - before[first]
    known = np.abs(apart) > _LEAST_APART * camera.width
    if not known.any():
        return R, 0.0
    first, second = first[known], second[known]
    factor = (after[second] - after[first]) / apart[known]
    shift = after[first] - factor * before[first]
    left = after[:, None] - factor * before[:, None] - shift
    middle = len(left) // 2
    medians = np.partition(left.real**2 + left.imag**2, middle, axis=0)[middle]
    medians[~((np.abs(factor) > 1 / _LARGEST_FACTOR) & (np.abs(factor) < _LARGEST_FACTOR))] = math.inf
    best = int(np.argmin(medians))
    if not np.isfinite(medians[best]):
        return R, 0.0
    zoom, turned = float(np.abs(factor[best])), float(np.angle(factor[best]))
    tilt = shift[best] / (zoom * camera.focal_px)
    R = R.copy()
    turn(R, -tilt.imag, tilt.real, turned)
    return R, zoom - 1
