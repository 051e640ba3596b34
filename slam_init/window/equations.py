"""The equations of a joint fit: cost, Gauss-Newton equations with the tracks eliminated, and the state after a step."""

from __future__ import annotations

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.lens import Lens
from slam_init.window.arguments import (
    FIELD_TERMS,
    LANES,
    ZOOM_TERMS,
    Equations,
    Known,
    Layout,
    Limits,
    Observed,
    Problem,
    Room,
    Unknowns,
    gather,
)
from slam_init.window.kernel import evaluate
from slam_init.window.optimizer import hold_length, move, optimize
from slam_init.window.state import Priors, WindowState
from slam_init.window.tracks import WindowTracks

#: Weight of an unknown that keeps its value.
_HELD = 1e12
#: Of a state without a plane.
_NO_PLANE: Floats = np.zeros(3)


def _layout_of(views: int, priors: Priors, *, rotation_only: bool) -> Layout:
    """The order of the common unknowns; points at infinity show no translation."""
    field = ZOOM_TERMS if priors.zoom_sigma > 0 else 0
    field = FIELD_TERMS if priors.field_sigma_px > 0 else field
    readout, principal = int(priors.readout_sigma_s > 0), 2 * int(priors.principal_sigma_px > 0)
    pose = 3 if rotation_only else 6
    block = pose + field
    focal, lens = block * (views - 1) + field, 2 + readout + principal
    return Layout(field, readout, principal, pose, block, focal, lens, focal + lens)


def unknowns_of(state: WindowState) -> Unknowns:
    """A state for the compiled loops, which read its arrays."""
    plane = _NO_PLANE if state.plane is None else state.plane
    lens = np.array([*state.lens[:3], *state.lens.principal_px])
    return Unknowns(state.R, state.t, state.field, plane, state.rays, state.inverse_distances, lens, state.on_plane)


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
        self._layout = layout = _layout_of(len(tracks.seen), priors, rotation_only=rotation_only)
        arrays = tracks.anchor, tracks.seen, tracks.pixels, tracks.sigma_px, tracks.whitening, tracks.sweep_px_s
        gathered = gather(*arrays, tracks.places, layout.field == FIELD_TERMS)
        observed = Observed(*gathered, priors.gate_sigmas**2)
        self.focal, size = layout.focal, layout.plane + 3 * (start.plane is not None)
        self._equations = Equations.empty(len(observed.tracks), len(tracks.seen), len(tracks.anchor), size)
        self.normal, self.gradient, self.costs, self.residuals, self.free, self.across, *_ = self._equations
        self.track_gradients, self.track_covariances = self._equations.own, self._equations.inverses
        self._room = Room.empty(size)
        lens = np.array([priors.mean.log_scale, priors.mean.k1, 0.0, 0.0, 0.0])
        weights, turned = self._weights_of_priors(), (tracks.turned, tracks.turned_weights)
        known = Known(tracks.camera.numbers, float(tracks.readout_s), rotation_only, weights, lens, *turned)
        self._problem = Problem(observed, known, layout)
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
        of_lanes = directions[self._problem.observed.tracks]
        return self._by_track(np.einsum("bgql,blq->bgl", self._coupled[:, :, :3], of_lanes))

    def cost(self, state: WindowState) -> float:
        """Cost of a state: twice the negative logarithm of its posterior density, up to a constant."""
        return self._evaluate(state, fill=False, hold=False)

    def build(self, state: WindowState, *, hold: bool = True) -> float:
        """Build the equations at a state.

        * ``hold``: Whether tracks at infinity whose distance would become negative are held there.
        """
        self._built = state.R
        return self._evaluate(state, fill=True, hold=hold)

    def optimized(self, state: WindowState, limits: Limits) -> tuple[WindowState, float, int, bool]:
        """Levenberg-Marquardt from a state; see :func:`slam_init.window.optimizer.optimize`.

        * Returns: The last state, its cost, the number of steps, and whether the fit was given up.
        """
        states = _copied(state), _copied(state), _copied(state)
        at, cost, steps, given_up = optimize(self._problem, self.held_view, limits, states, self._equations, self._room)
        return _state_of(states[at], state), cost, steps, given_up

    def prior_gradient(self, state: WindowState) -> Floats:
        """The part of the gradient that does not come from the tracks: of the lens, the fields and the rotations.

        Shapes: returns (G,).
        """
        observed = self._problem.observed
        none = self._problem._replace(observed=observed._replace(tracks=observed.tracks[:0]))
        place = Equations.empty(0, len(self.tracks.seen), len(self.tracks.anchor), len(self.gradient))
        evaluate(none, unknowns_of(state), place, self._room, True, False, False)
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
        move(self._problem, unknowns_of(state), step, length, self._equations, self._room, after)
        return _state_of(after, state)

    @property
    def _coupled(self) -> Floats:
        return self._equations.coupled.reshape(-1, len(self.gradient), 4, LANES)

    def _by_track(self, of_blocks: Floats) -> Floats:
        """Derivatives of each track by the common unknowns, turned from the axes of the world into those of the views.

        Shapes: ``of_blocks`` (B, G, LANES), returns (T, G).
        """
        observed, layout, turned = self._problem.observed, self._layout, of_blocks.copy()
        for k in range(1, len(self._built)):
            first = layout.field + layout.block * (k - 1)
            for at in range(first, first + layout.pose, 3):
                turned[:, at : at + 3] = self._built[k] @ turned[:, at : at + 3]
        used = np.arange(LANES) < observed.counts[:, None]
        of_tracks = np.zeros((len(self.tracks.anchor), of_blocks.shape[1]))
        of_tracks[observed.tracks[used]] = turned.swapaxes(1, 2)[used]
        return of_tracks

    def _evaluate(self, state: WindowState, *, fill: bool, hold: bool) -> float:
        return evaluate(self._problem, unknowns_of(state), self._equations, self._room, fill, hold, True)

    def _weights_of_priors(self) -> Floats:
        """One over the variance of each common unknown before the tracks are seen."""
        priors, layout, weights = self.priors, self._layout, np.zeros(len(self.gradient))
        lens = [priors.focal_sigma, priors.k1_sigma]
        lens += layout.readout * [priors.readout_sigma_s] + layout.principal * [priors.principal_sigma_px]
        weights[self.focal : layout.plane] = [1 / sigma**2 for sigma in lens]
        if priors.field_sigma_px > 0:
            weights[self.columns_of_fields()] = 1 / priors.field_sigma_px**2
        elif priors.zoom_sigma > 0:
            sigmas = np.array([priors.zoom_sigma, priors.shift_sigma_px, priors.shift_sigma_px])
            for k in range(len(self.tracks.seen)):
                # What all views have in common is the lens.
                weights[self._field_columns(k)] = sigmas**-2.0 if k else _HELD
        poses = np.arange(layout.field, self.focal, layout.block)[:, None] + np.arange(3)
        weights[poses] += self.tracks.turned_weights[1:, None]
        return weights

    def _field_columns(self, view: int) -> Ints:
        first = self._layout.field + self._layout.block * (view - 1) + self._layout.pose if view else 0
        return np.arange(first, first + self._layout.field)


def _copied(state: WindowState) -> Unknowns:
    """A copy of a state, whose arrays receive steps."""
    return Unknowns._make(array.copy() for array in unknowns_of(state))


def _state_of(unknowns: Unknowns, before: WindowState) -> WindowState:
    """The state in some arrays, which are its own from now on; ``before`` has the same tracks on the plane."""
    R, t, field, plane, rays, inverse_distances, numbers, on_plane = unknowns
    log_scale, k1, readout_s, x, y = numbers.tolist()
    lens, kept = Lens(log_scale, k1, readout_s, (x, y)), None if before.plane is None else plane
    return WindowState(R, t, rays, inverse_distances, lens, field, kept, on_plane)


def explained_at_most(freedom: Ints) -> Floats:
    """The largest cost of a track that a motion explains.

    A track that neither of two motions explains must have the same cost with both. Otherwise outliers would vote, each
    one by chance but with a large weight. The bound is the mean of chi-square plus five of its standard deviations; one
    correct track in a thousand exceeds it.

    Shapes: ``freedom`` (T,), returns (T,).
    """
    return np.asarray(freedom + 5 * np.sqrt(2.0 * freedom))
