"""A lens that changes from view to view: what it explains of the tracks, and what it does to the directions.

A forward motion to a plane parallel to the image moves the pixels exactly as a zoom does, and a small rotation moves
them as a shift of the image does. The expansion of a fit shows how far the tracks distinguish them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.correlated_errors import FIELD_SCALES_PX
from slam_init.window.arguments import FIELD_TERMS
from slam_init.window.joint_fit import JointFit
from slam_init.window.kernel import TUKEY_GATES
from slam_init.window.levels import SHIFTS, ZOOMS
from slam_init.window.uncertainty import ExpandedFit

#: A lens that zooms shifts a view by its optical axis, over the width of the image: half a pixel of 1280.
_NO_SHIFT = 3e-4
#: A zoom is smooth in time, or independent in each view.
_WAYS_TO_ZOOM = 2


@dataclass(frozen=True, eq=False)
class VaryingLens:
    """Whether the lens is the same in all views, and how certain the directions are if it is not."""

    #: (M + 1,) Logarithms of the weights: that the lens is the same, then that it zooms, then that views are shifted.
    log_weights: Floats
    #: (M + 1, V - 1) Factors on the standard deviations of the directions; 1 if the lens is the same.
    factors: Floats
    #: (M + 1, V - 1) How far the directions move; 0 if the lens is the same.
    moved_deg: Floats

    @property
    def probabilities(self) -> Floats:
        """Probability that the lens is the same, then of each mode.

        Shapes: returns (M + 1,).
        """
        weights = np.exp(self.log_weights - self.log_weights.max())
        return np.asarray(weights / weights.sum())


def varying_lens(expanded: ExpandedFit) -> VaryingLens:
    """What a zoom and a shift of each view explain of the tracks, and what they change about the directions.

    The expansion of the fit gives both: the gradient of the cost by the zooms and the shifts, and their information.
    The first view has none, as what all views have in common is the lens. The fields have their likeliest scale.
    """
    lin, tracks, lens_changes = expanded.linearization, expanded.fit.tracks, expanded.fit.priors.lens_changes
    views = len(expanded.fit.state.R)
    other, field, H = ~lin.is_field, lin.is_field, lin.information
    known = H[np.ix_(other, other)] + 1e-9 * np.eye(int(other.sum()))
    units = np.sqrt(np.maximum(np.diag(known), 1e-300))
    covariance = np.linalg.inv(known / np.outer(units, units)) / np.outer(units, units)
    follow = covariance @ H[np.ix_(other, field)]
    left = H[np.ix_(field, field)] - H[np.ix_(field, other)] @ follow
    gradient = lin.gradient[field] - follow.T @ lin.gradient[other]
    scale_px = float(FIELD_SCALES_PX[int(np.argmax(expanded.scale_weights))])
    given = np.zeros_like(left)
    if scale_px:
        given = np.linalg.inv(0.5 * (left + left.T) + np.eye(len(left)) / scale_px**2)
    # Given a zoom or a shift, the fields take a part of it back.
    alone = zooms_and_shifts(tracks.camera, views)
    B = alone - given @ (left @ alone)
    information, gradient = B.T @ left @ alone, B.T @ gradient
    gradient[::3] += shrunk_noise(expanded.fit)
    J, along = expanded.directions, expanded.directions @ follow
    fixed = J @ covariance @ np.swapaxes(J, 1, 2) + along @ given @ np.swapaxes(along, 1, 2)
    by_mode, largest_fixed = along @ B, np.maximum(np.linalg.eigvalsh(fixed)[:, -1], 1e-300)
    log_weights, factors, moved_deg = (
        [math.log(1 - lens_changes * sum(prior for _, prior in (*ZOOMS, *SHIFTS)))],
        [np.ones(views - 1)],
        [np.zeros(views - 1)],
    )
    for root, prior in _modes(tracks.camera, tracks.times_s) if lens_changes else ():
        scaled = root.T @ (0.5 * (information + information.T)) @ root + np.eye(len(root))
        posterior = root @ np.linalg.inv(scaled) @ root.T
        mean = -posterior @ gradient
        evidence = 0.5 * float(gradient @ posterior @ gradient) - 0.5 * float(np.linalg.slogdet(scaled)[1])
        log_weights.append(math.log(lens_changes * prior) + evidence)
        moved = by_mode @ posterior @ np.swapaxes(by_mode, 1, 2)
        factors.append(np.sqrt(np.maximum(np.linalg.eigvalsh(fixed + moved)[:, -1] / largest_fixed, 1.0)))
        moved_deg.append(np.degrees(np.linalg.norm(by_mode @ mean, axis=1)))
    return VaryingLens(np.array(log_weights), np.array(factors), np.array(moved_deg))


def _modes(camera: Camera, times_s: Floats) -> Iterator[tuple[Floats, float]]:
    """How a lens may change: roots (3 V - 3, 3 V - 3) of the prior covariances of all views, and their probabilities.

    A lens that focuses zooms smoothly, or it has settled again in each view: both are alike probable. Independent zooms
    alone would let a slow zoom pay for as many unknowns as there are views, so that it would be less likely than none.
    A stabilizer moves each frame for itself.
    """
    smooth, settled = np.asarray(np.linalg.cholesky(zoom_covariance(times_s))), np.eye(len(times_s) - 1)
    for zoom, prior in ZOOMS:
        for root in (smooth, settled):
            yield _root(zoom * root, _NO_SHIFT * camera.width), prior / _WAYS_TO_ZOOM
    for shift, prior in SHIFTS:
        yield _root(shift / 3 * settled, shift * camera.width), prior


def _root(of_zooms: Floats, shift_px: float) -> Floats:
    """The root (3 V - 3, 3 V - 3) of the prior covariance of zooms and of shifts that are independent."""
    root = np.kron(np.eye(len(of_zooms)), np.diag([0.0, shift_px, shift_px]))
    root[::3, ::3] = of_zooms
    return np.asarray(root)


def zoom_covariance(times_s: Floats) -> Floats:
    """Covariance of the zooms of all views but the first, over that of the first, of a lens with a deviation of 1.

    How a zoom proceeds in time is not known: it is a smooth random function (Matern 3/2), with the length of the window
    as its scale.

    Shapes: ``times_s`` (V,), returns (V - 1, V - 1).
    """
    spans = np.abs(times_s[:, None] - times_s[None])
    apart = math.sqrt(3) * spans / max(float(spans.max()), 1e-9)
    smooth = (1 + apart) * np.exp(-apart)
    from_first = smooth - smooth[:, :1] - smooth[:1] + smooth[0, 0]
    # A view at the time of another one has a zoom of its own, however small.
    return np.asarray(from_first[1:, 1:] + 1e-6 * np.eye(len(times_s) - 1))


def shrunk_noise(fit: JointFit) -> Floats:
    """What the gradient by the zoom of each view but the first lacks, where fields describe the zooms.

    The fields are polynomials of the measured pixels. A zoom of these shrinks their noise as well: with N tracks in a
    view the gradient has an expectation of -2 N. A lens zooms the projections, which are a residual away.

    Shapes: returns (V - 1,).
    """
    tracks, squares = fit.tracks, np.sum(fit.residuals**2, axis=2)
    left_of_gate = np.maximum(1 - squares / (TUKEY_GATES * fit.priors.gate_sigmas**2), 0.0)
    used = tracks.seen & (tracks.anchor >= 0) & (left_of_gate > 0)
    return np.asarray(np.sum(left_of_gate**2 * np.where(used, squares, 0.0), axis=1)[1:])


def zooms_and_shifts(camera: Camera, views: int) -> Floats:
    """The coefficients (12 V, 3 V - 3) of the fields by the zoom and the shift (x, y) of each view but the first."""
    own = np.zeros((FIELD_TERMS, 3))
    half = FIELD_TERMS // 2
    # The linear terms have a mean square of 1 over the image.
    own[1, 0], own[half + 2, 0] = (camera.width - 1) / math.sqrt(12), (camera.height - 1) / math.sqrt(12)
    own[0, 1] = own[half, 2] = 1.0
    return np.asarray(np.kron(np.eye(views)[:, 1:], own), np.float64)
