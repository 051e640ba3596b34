"""The hypothesis that the camera only rotates, with a lens that zooms and an image that shifts from view to view.

A lens that focuses changes the focal length of each view by up to some hundredths. That looks like a motion toward a
plane. A stabilizer shifts the image of each view by up to a hundredth of its width. That looks like a motion along a
plane. So a map has to gain over this camera too. A zoom ``z`` and a shift ``s`` of a view are undone in its pixels,
``c + (x - s - c) / (1 + z)``, and the noise is that of the pixels as measured. First each view is located: its
rotation, zoom and shift by the rays that earlier views have measured. Then the rotations and the rays of all views are
fitted jointly, and the views are located again, in turn: without shifts first, then with them, and with both at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from quest.algebra import turn
from slam_init.types.arrays import Floats, evenly_spaced
from slam_init.types.camera import Camera
from slam_init.types.lens import Lens
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.joint_fit import fit_window
from slam_init.window.levels import LARGEST_ZOOM, SHIFTS, ZOOM_LEAVES, ZOOMED_COST, ZOOMS
from slam_init.window.measured_rays import measured_rays
from slam_init.window.projection import camera_vector
from slam_init.window.state import Priors, WindowState, start_at
from slam_init.window.tracks import WindowTracks
from slam_init.window.zoomed_view import locate_view

#: Views are located and fitted in turn so often, with so many steps of a fit. It ends where a round lowers the cost by
#: less than this share of what is left to the best motion: zooms do not explain it then.
_ROUNDS, _MAX_STEPS, _LEAST_PROGRESS = 8, 8, 0.1
#: Where zooms leave at most this share of what the rotation leaves to the best motion, further focal lengths of the
#: reference are tried: off by this factor (as a logarithm). One simulated camera on a tripod zoomed by 1.5 before its
#: reference: the fit from the stated focal length left 41 %, and with these starts 1 %.
#: Class: assumption.
_ZOOMS_LEAVE, _REFERENCE_ZOOM = 0.7, 0.3
#: A similarity by two tracks is tried so often: where two fifths of the tracks are at rest, all fail once in 70 000
#: times. So many tracks vote. The two tracks lie this far apart, over the width of the image. No view is zoomed by more
#: than this factor.
_SIMILARITIES, _SIMILAR_TRACKS, _LEAST_APART, _LARGEST_FACTOR = 64, 100, 0.1, 3.0
#: Views that are nearer in time count as this far apart.
_LEAST_SPAN_S = 1e-3
#: From coordinates to complex numbers.
_COMPLEX = np.array([1, 1j])
#: Standard deviation of the shifts where there are none.
_NO_SHIFT_PX = 1e-6
#: Fewer tracks than this do not locate a view: twice its four unknowns, at two coordinates a track.
_LEAST_TRACKS = 4


@dataclass(frozen=True, eq=False)
class ZoomingRotation:
    """A camera that rotates, and whose images zoom and shift from view to view."""

    #: Those of the window with this camera in place of the one that only rotates, and both undone in the tracks.
    hypotheses: WindowHypotheses
    #: (V,) Of the views of the window.
    zooms: Floats
    #: (V, 2) In pixels.
    shifts: Floats
    #: What both cost, in twice the nats.
    price: float = 0.0

    @property
    def cost(self) -> float:
        """Of the fit, with the price of the zooms and the shifts."""
        return self.hypotheses.rotation_only.cost

    @property
    def has_zooms(self) -> bool:
        """Whether a zoom is larger than the smallest that the lens of a motion is given."""
        return float(np.abs(self.zooms).max()) > ZOOMS[0][0]

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
        part, before = zoomed(hypotheses.tracks, self.zooms, self.shifts), self.hypotheses
        start = _again(part, before.rotation_only.state)
        fit = fit_window(part, start, before.rotation_priors, rotation_only=True, max_steps=_MAX_STEPS)
        fit = replace(fit, cost=fit.cost + self.price)
        again = replace(hypotheses, tracks=part, rotation_only=fit, rotation_priors=before.rotation_priors)
        first = replace(self, hypotheses=again)
        return _alternated(hypotheses, fit.state, before.rotation_priors, first)

    @property
    def explains_all(self) -> bool:
        """Whether the best motion gains nothing over it, so that it is as probable as it can be."""
        return self.hypotheses.gain_over_rotation[0] <= 0

    def explains_much(self, hypotheses: WindowHypotheses) -> bool:
        """Whether they explain a good part of what a camera that only rotates leaves to the best motion."""
        best = hypotheses.motions[0].fit.cost
        return self.cost - best < _ZOOMS_LEAVE * (hypotheses.rotation_only.cost - best)


def with_zooms(hypotheses: WindowHypotheses) -> ZoomingRotation:
    """Let the images of the camera that only rotates zoom and shift from view to view."""
    tracks, rotating = hypotheses.tracks, hypotheses.rotation_only
    # A readout would take the place of zooms, so it is that of the best motion.
    priors = replace(hypotheses.priors, readout_sigma_s=0.0)
    t = np.outer(np.arange(len(rotating.state.R)), [1e-9, 0.0, 0.0])
    lens = Lens(readout_s=hypotheses.motions[0].fit.state.lens.readout_s)
    state = start_at(tracks, rotating.state.R, t, lens=lens, at_infinity=True)
    lowest = _alternated(hypotheses, state, priors)
    if lowest.cost > hypotheses.motions[0].fit.cost and lowest.explains_much(hypotheses):
        # The reference may be zoomed as well, as its distance from the stated focal length.
        free = replace(priors, focal_sigma=max(priors.focal_sigma, _REFERENCE_ZOOM))
        for log_scale in (_REFERENCE_ZOOM, -_REFERENCE_ZOOM):
            other = _alternated(hypotheses, replace(state, lens=lens._replace(log_scale=log_scale)), free)
            if other.cost < lowest.cost:
                lowest = other
    if lowest.explains_all:
        return lowest
    # Shifts come last: beside a zoom that is not known yet, moving objects would lead them away. But without shifts,
    # zooms and the focal length may take their place: so both come at once too.
    found = _alternated(hypotheses, state, lowest.hypotheses.rotation_priors if lowest.zooms.any() else priors, lowest)
    if lowest.zooms.any():
        found = min(found, _alternated(hypotheses, state, priors, _unchanged(hypotheses)), key=lambda one: one.cost)
    return found


def _unchanged(hypotheses: WindowHypotheses) -> ZoomingRotation:
    """The camera that only rotates, with a lens that does not change."""
    views = len(hypotheses.rotation_only.state.R)
    return ZoomingRotation(hypotheses, np.zeros(views), np.zeros((views, 2)))


def _alternated(
    hypotheses: WindowHypotheses, state: WindowState, priors: Priors, lowest: ZoomingRotation | None = None
) -> ZoomingRotation:
    """Locate the views and fit them jointly, in turn, from the rotations and the lens of a state.

    * ``lowest``: To go on from, with shifts; by default there are none.
    """
    tracks, best = hypotheses.tracks, hypotheses.motions[0].fit
    sigma_px = _NO_SHIFT_PX if lowest is None else SHIFTS[-1][0] * tracks.camera.width
    zooms, shifts, rays = np.zeros(len(state.R)), np.zeros((len(state.R), 2)), None
    if lowest is not None and lowest.zooms.any():
        zooms, state = lowest.zooms, lowest.hypotheses.rotation_only.state
        rays = state.rays
    state, zooms, shifts = _located(tracks, state, zooms, shifts, sigma_px, rays)
    lowest, before = lowest or _unchanged(hypotheses), math.inf
    for _ in range(_ROUNDS):
        part = zoomed(tracks, zooms, shifts)
        start = _again(part, state)
        fit = fit_window(part, start, priors, rotation_only=True, max_steps=_MAX_STEPS, hopeless=lowest.cost)
        price = min(float(np.sum((zooms / LARGEST_ZOOM) ** 2)), ZOOMED_COST)
        price += float(np.sum((shifts / sigma_px) ** 2))
        cost = fit.cost + price
        if cost < lowest.cost:
            fit_with_price = replace(fit, cost=cost)
            found = replace(hypotheses, tracks=part, rotation_only=fit_with_price, rotation_priors=priors)
            lowest = ZoomingRotation(found, zooms, shifts, price)
        if before - cost < _LEAST_PROGRESS * (cost - best.cost):
            break
        before = cost
        state, zooms, shifts = _located(tracks, fit.state, zooms, shifts, sigma_px, fit.state.rays)
    return lowest


def _again(tracks: WindowTracks, state: WindowState) -> WindowState:
    """The rotations and the lens of a state, with the rays as measured."""
    return start_at(tracks, state.R, state.t, lens=state.lens, at_infinity=True)


def zoomed(tracks: WindowTracks, zooms: Floats, shifts: Floats | None = None) -> WindowTracks:
    """The tracks with the zooms and the shifts of the views undone.

    Shapes: ``zooms`` (V,), ``shifts`` (V, 2).
    """
    factors, shifts = 1 + zooms, np.zeros((len(zooms), 2)) if shifts is None else shifts
    pixels = _undone(tracks.pixels, _centre(tracks.camera), zooms[:, None], shifts[:, None])
    places = tracks.places * factors[:, None, None]
    return replace(tracks, pixels=pixels, sigma_px=tracks.sigma_px / factors[:, None], places=places)


def _undone(pixels: Floats, centre: Floats, zooms: Floats, shifts: Floats) -> Floats:
    """Pixels (..., 2) with their zooms (...) and shifts (..., 2) undone."""
    return np.asarray(centre + (pixels - shifts - centre) / (1 + zooms)[..., None])


def _centre(camera: Camera) -> Floats:
    return np.array([camera.cx, camera.cy])


def _located(
    tracks: WindowTracks, state: WindowState, zooms: Floats, shifts: Floats, shift_px: float, rays: Floats | None = None
) -> tuple[WindowState, Floats, Floats]:
    """The rotations, the zooms (V,) and the shifts (V, 2) of the views, one view after another.

    * ``shift_px``: Standard deviation of the shifts.
    * ``rays``: (T, 3) In the anchor views; by default as measured, with those of the views located before.
    """
    camera = tracks.camera.refocused(state.lens.log_scale, state.lens.k1)
    R, zooms, shifts, anchor = state.R.copy(), zooms.copy(), shifts.copy(), np.maximum(tracks.anchor, 0)
    at_anchor, lens = tracks.pixels[anchor, np.arange(len(anchor))], camera_vector(camera)
    off_px = np.array(state.lens.principal_px)
    for k in range(1, len(R)):
        used = tracks.seen[k] & (tracks.anchor >= 0) & (tracks.anchor < k)
        measured = tracks.pixels[k] - off_px
        if rays is None:
            of_anchor = _undone(at_anchor, _centre(tracks.camera), zooms[anchor], shifts[anchor]) - off_px
            from_anchor = measured_rays(camera, of_anchor[None], used[None])[0]
        else:
            from_anchor = rays
        used &= np.isfinite(from_anchor).all(axis=1)
        if used.sum() >= _LEAST_TRACKS:
            world = np.einsum("tji,tj->ti", R[anchor[used]], from_anchor[used])
            starts = [(R[k], zooms[k], shifts[k])]
            if rays is None:  # nothing is located yet
                starts.append((*_similar(camera, world, measured[used], R[k]), np.zeros(2)))
            sigma_px = tracks.sigma_px[k, used]
            found = [locate_view(lens, world, measured[used], *one, shift_px, sigma_px) for one in starts]
            R[k], zooms[k], shifts[k], _ = min(found, key=lambda one: one[3])
    return replace(state, R=R), zooms, shifts


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
