"""The equations of a joint fit: cost, Gauss-Newton equations with the tracks eliminated, and the state after a step."""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.lens import Lens
from slam_init.window.arguments import (
    FIELD_TERMS,
    ZOOM_TERMS,
    Equations,
    Known,
    Layout,
    Limits,
    Observed,
    Room,
    Unknowns,
)
from slam_init.window.blocks import gather, list_blocks
from slam_init.window.kernel import evaluate
from slam_init.window.optimizer import hold_length, optimize
from slam_init.window.rows import LANES, OBSERVED_ROWS
from slam_init.window.state import Priors, WindowState
from slam_init.window.steps import move
from slam_init.window.tracks import WindowTracks

#: Weight of an unknown that keeps its value.
_HELD = 1e12
#: Of a state without a plane.
_NO_PLANE: Floats = np.zeros(3)


def observed_by(tracks: WindowTracks, gate_sigmas: float, *, has_fields: bool) -> Observed:
    """Gather the observations of the tracks that take part, in blocks with one anchor view each."""
    views, most = len(tracks.seen), len(tracks.anchor) // LANES + len(tracks.seen)
    lanes, anchors, counts = np.empty((most, LANES), np.int64), np.empty(most, np.int64), np.empty(most, np.int64)
    blocks = list_blocks(tracks.anchor, views, lanes, anchors, counts)
    rows = np.empty((blocks * views, OBSERVED_ROWS * LANES))
    lanes, anchors, counts = lanes[:blocks], anchors[:blocks], counts[:blocks]
    gather(
        tracks.pixels, tracks.sigma_px, tracks.whitening, tracks.sweep_px_s, tracks.places, tracks.seen, lanes, counts,
        has_fields, rows,
    )  # fmt: skip
    return Observed(lanes, anchors, counts, rows, gate_sigmas**2)


def _field_terms(priors: Priors) -> int:
    """The number of coefficients of the field of a view, or of its zoom and its shift."""
    if priors.field_sigma_px > 0:
        return FIELD_TERMS
    return ZOOM_TERMS if priors.zoom_sigma > 0 else 0


def unknowns_of(state: WindowState) -> Unknowns:
    """A state for the compiled loops, which read its arrays."""
    plane = _NO_PLANE if state.plane is None else state.plane
    lens = np.array([*state.lens[:3], *state.lens.principal_px])
    return Unknowns(state.R, state.t, state.field, plane, state.rays, state.inverse_distances, lens, state.on_plane)


def _known_of(tracks: WindowTracks, priors: Priors, weights: Floats, *, at_infinity: bool) -> Known:
    """What is known before the tracks are seen."""
    lens = np.array([priors.mean.log_scale, priors.mean.k1, 0.0, 0.0, 0.0])
    turned = tracks.turned, tracks.turned_weights
    return Known(tracks.camera.numbers, float(tracks.readout_s), at_infinity, weights, lens, *turned)


class WindowEquations:
    """The equations of one window and one kind of hypothesis; holds the arrays that all steps share.

    * ``start``: Its plane says whether points may lie on a plane. The length of its longest baseline is held.
    * ``rotation_only``: Whether all points are at infinity.
    * ``normal``: (G, G) The normal matrix of the last :meth:`build`, with the scale free.
    * ``gradient``: (G,) Of the common unknowns, tracks eliminated.
    * ``costs, residuals, free, across``: Of the last state, see :class:`slam_init.window.arguments.Equations`.
    * ``track_gradients, track_covariances``: (T, 3), (T, 3, 3) Gradient of each track by its unknowns (two of its ray,
      and the inverse distance), and the inverse of its equations.
    * ``focal``: Place of the focal length among the common unknowns. The distortion follows it, then the readout and
      the principal point where they are unknown.
    * ``held_view``: View whose baseline is held.
    """

    def __init__(self, tracks: WindowTracks, start: WindowState, priors: Priors, rotation_only: bool = False) -> None:
        self.tracks, self.priors, self.rotation_only = tracks, priors, rotation_only
        self._layout = layout = Layout.of(
            len(tracks.seen), field=_field_terms(priors), readout=priors.readout_sigma_s > 0,
            principal=priors.principal_sigma_px > 0, rotation_only=rotation_only,
        )  # fmt: skip
        self.focal = layout.focal
        self._observed, size = (
            observed_by(tracks, priors.gate_sigmas, has_fields=layout.field == FIELD_TERMS),
            layout.plane + 3 * (start.plane is not None),
        )
        self._equations = Equations.empty(len(self._observed.tracks), len(tracks.seen), len(tracks.anchor), size)
        self.normal, self.gradient, self.costs, self.residuals, self.free, self.across, *_ = self._equations
        self.track_gradients, self.track_covariances = self._equations.own, self._equations.inverses
        self._room = Room.empty(size)
        self._known = _known_of(tracks, priors, self._weights_of_priors(), at_infinity=rotation_only)
        self._built = start.R
        self.held_view = int(np.argmax(np.linalg.norm(start.t, axis=1)))

    @property
    def squares(self) -> Floats:
        """Squared residual of each observation in units of the noise, at the last state.

        Shapes: returns (V, T).
        """
        return np.asarray(np.einsum("vtq,vtq->vt", self.residuals, self.residuals))

    @property
    def shares(self) -> Floats:
        """The share of each track in the gradient of the common unknowns.

        Shapes: returns (T, G).
        """
        return self._by_track(self._coupled[:, :, 3])

    def coupling_along(self, directions: Floats) -> Floats:
        """How the gradient of each track along a direction of its own unknowns follows the common unknowns.

        Shapes: ``directions`` (T, 3), returns (T, G).
        """
        of_lanes = directions[self._observed.tracks]
        return self._by_track(np.einsum("bgql,blq->bgl", self._coupled[:, :, :3], of_lanes))

    def cost(self, state: WindowState) -> float:
        """Cost of a state: twice the negative logarithm of its posterior density, up to a constant."""
        return self._evaluate(state, fill=False, hold=False)

    def build(self, state: WindowState, *, hold: bool = True) -> float:
        """Build the equations at a state.

        * ``hold``: Whether tracks at infinity whose distance would become negative are held there.
        """
        return self._evaluate(state, fill=True, hold=hold)

    def optimized(self, state: WindowState, limits: Limits) -> tuple[WindowState, float, int, bool]:
        """Levenberg-Marquardt from a state; see :func:`slam_init.window.optimizer.optimize`.

        * Returns: The last state, its cost, the number of steps, and whether the fit was given up.
        """
        states = _copied(state), _copied(state), _copied(state)
        at, cost, steps, given_up = optimize(
            self._observed, self._known, self._layout, self.held_view, limits, states, self._equations, self._room
        )
        return _state_of(states[at], state), cost, steps, given_up

    def stopped(self, state: WindowState) -> Bools:
        """The tracks at infinity whose distance would become negative, by the last equations.

        Shapes: returns (T,).
        """
        if self.rotation_only:
            return np.zeros(len(state.rays), bool)
        return np.asarray(~state.on_plane & (state.inverse_distances == 0) & (self.track_gradients[:, 2] > 0))

    def prior_gradient(self, state: WindowState) -> Floats:
        """The part of the gradient that does not come from the tracks: of the lens, the fields and the rotations.

        Shapes: returns (G,).
        """
        none = self._observed._replace(tracks=self._observed.tracks[:0])
        place = Equations.empty(0, len(self.tracks.seen), len(self.tracks.anchor), len(self.gradient))
        evaluate(none, self._known, self._layout, unknowns_of(state), place, self._room, True, False, False)
        return place.gradient

    def columns_of_fields(self) -> Bools:
        """Which common unknowns are coefficients of fields of correlated errors.

        Shapes: returns (G,).
        """
        columns = np.zeros(len(self.gradient), bool)
        for k in range(len(self.tracks.seen)):
            columns[self._field_columns(k)] = True
        return columns

    def information(self, state: WindowState) -> Floats:
        """The normal matrix of the last equations with the length of one baseline held.

        Shapes: returns (G, G).
        """
        normal = self.normal.copy()
        hold_length(normal, state.t, self.held_view, self._layout)
        return normal

    def moved(self, state: WindowState, step: Floats, length: float = 1.0) -> WindowState:
        """The state after a step of the common unknowns, which the tracks follow by the last equations.

        Shapes: ``step`` (G,).
        """
        after = _copied(state)
        move(
            unknowns_of(state), step, length, self._observed, self._known, self._layout, self._equations, self._room,
            after,
        )  # fmt: skip
        return _state_of(after, state)

    @property
    def _coupled(self) -> Floats:
        return self._equations.coupled.reshape(-1, len(self.gradient), 4, LANES)

    def _by_track(self, of_blocks: Floats) -> Floats:
        """Derivatives of each track by the common unknowns, turned from the axes of the world into those of the views.

        Shapes: ``of_blocks`` (B, G, LANES), returns (T, G).
        """
        tracks, counts, layout = self._observed.tracks, self._observed.counts, self._layout
        turned = of_blocks.copy()
        for k in range(1, len(self._built)):
            first = layout.field + layout.block * (k - 1)
            for at in range(first, first + layout.pose, 3):
                turned[:, at : at + 3] = self._built[k] @ turned[:, at : at + 3]
        used = np.arange(LANES) < counts[:, None]
        of_tracks = np.zeros((len(self.tracks.anchor), of_blocks.shape[1]))
        of_tracks[tracks[used]] = turned.swapaxes(1, 2)[used]
        return of_tracks

    def _evaluate(self, state: WindowState, *, fill: bool, hold: bool) -> float:
        if fill:
            self._built = state.R
        return evaluate(
            self._observed, self._known, self._layout, unknowns_of(state), self._equations, self._room, fill, hold, True
        )

    def _weights_of_priors(self) -> Floats:
        """One over the variance of each common unknown before the tracks are seen."""
        priors, weights = self.priors, np.zeros(len(self.gradient))
        weights[self.focal], weights[self.focal + 1] = 1 / priors.focal_sigma**2, 1 / priors.k1_sigma**2
        if self._layout.readout:
            weights[self.focal + 2] = 1 / priors.readout_sigma_s**2
        if self._layout.principal:
            weights[self._principal_columns] = 1 / priors.principal_sigma_px**2
        if priors.field_sigma_px > 0:
            weights[self.columns_of_fields()] = 1 / priors.field_sigma_px**2
        elif priors.zoom_sigma > 0:
            sigmas = np.array([priors.zoom_sigma, priors.shift_sigma_px, priors.shift_sigma_px])
            for k in range(len(self.tracks.seen)):
                # What all views have in common is the lens.
                weights[self._field_columns(k)] = sigmas**-2.0 if k else _HELD
        poses = np.arange(self._layout.field, self.focal, self._layout.block)[:, None] + np.arange(3)
        weights[poses] += self.tracks.turned_weights[1:, None]
        return weights

    @property
    def _principal_columns(self) -> Ints:
        first = self.focal + 2 + self._layout.readout
        return np.arange(first, first + self._layout.principal)

    def _field_columns(self, view: int) -> Ints:
        first = self._layout.field + self._layout.block * (view - 1) + self._layout.pose if view else 0
        return np.arange(first, first + self._layout.field)


def _copied(state: WindowState) -> Unknowns:
    """A copy of a state, whose arrays receive steps."""
    read = unknowns_of(state)
    R, t, field, plane, rays, distances, lens = (array.copy() for array in read[:7])
    return Unknowns(R, t, field, plane, rays, distances, lens, read.on_plane)


def _state_of(unknowns: Unknowns, before: WindowState) -> WindowState:
    """The state in some arrays, which are its own from now on; ``before`` has the same tracks on the plane."""
    lens = unknowns.lens
    return WindowState(
        R=unknowns.R,
        t=unknowns.t,
        rays=unknowns.rays,
        inverse_distances=unknowns.inverse_distances,
        lens=Lens(float(lens[0]), float(lens[1]), float(lens[2]), (float(lens[3]), float(lens[4]))),
        field=unknowns.field,
        plane=None if before.plane is None else unknowns.plane,
        on_plane=unknowns.on_plane,
    )


def explained_at_most(freedom: Ints) -> Floats:
    """The largest cost of a track that a motion explains.

    A track that neither of two motions explains must have the same cost with both. Otherwise outliers would vote, each
    one by chance but with a large weight. The bound is the mean of chi-square plus five of its standard deviations; one
    correct track in a thousand exceeds it.

    Shapes: ``freedom`` (T,), returns (T,).
    """
    return np.asarray(freedom + 5 * np.sqrt(2.0 * freedom))


def tangent_bases(rays: Floats) -> tuple[Floats, Floats]:
    """Two orthonormal vectors orthogonal to each ray, as :func:`quest.algebra.tangents`.

    Shapes: ``rays`` (T, 3), returns ``first, second`` (T, 3).
    """
    x, y, z = rays.T
    none = np.zeros_like(x)
    smallest = np.argmin(np.abs(rays), axis=1)
    first = np.where(
        (smallest == 0)[:, None],
        np.stack([none, z, -y], axis=1),
        np.where((smallest == 1)[:, None], np.stack([-z, none, x], axis=1), np.stack([y, -x, none], axis=1)),
    )
    first = first / np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    return first, np.cross(rays, first)
