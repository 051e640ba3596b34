"""The equations of a joint fit: cost, Gauss-Newton equations with the tracks eliminated, and the state after a step."""

from __future__ import annotations

import numpy as np

from quest.geometry.quaternion import vector_from_rotation
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.arguments import Equations, Fitted, Layout, Lens, Observed, Scene, Sums
from slam_init.window.kernels import accumulate
from slam_init.window.levels import LARGEST_VOTE
from slam_init.window.projection import camera_vector
from slam_init.window.state import Priors, WindowState
from slam_init.window.steps import step_poses, step_tracks
from slam_init.window.track_equations import collect, eliminate
from slam_init.window.tracks import WindowTracks

#: Cost of a track that leaves the plane: as much as a track may vote for or against a hypothesis.
OFF_PLANE_COST = LARGEST_VOTE
#: Stiffness of the held baseline over that of its view.
_GAUGE = 1e4
#: Degrees of freedom of Student's distribution of measured gravity: an accelerometer that is not at rest, or a mount
#: that is not known, is off by many deviations.
#: Class: assumption.
_GRAVITY_TAIL = 3.0
#: Of a state without a plane.
_NO_PLANE: Floats = np.zeros(3)


def observed_by(tracks: WindowTracks, gate_sigmas: float) -> Observed:
    """Collect the observations of some tracks."""
    count = int(tracks.seen[:, tracks.anchor >= 0].sum())
    records, view = np.empty((count, 9)), np.empty(count, np.int64)
    first = np.empty(len(tracks.anchor) + 1, np.int64)
    collect(
        tracks.pixels, tracks.sigma_px, tracks.whitening, tracks.sweep_px_s, tracks.seen, tracks.anchor,
        records, view, first,
    )  # fmt: skip
    return Observed(records, view, first, tracks.places, tracks.anchor, gate_sigmas**2)


def lens_of(tracks: WindowTracks, state: WindowState, camera: Floats) -> Lens:
    """The lens of a state; ``camera`` (31,) is that of the tracks."""
    return Lens(camera, state.log_scale, state.k1, state.readout_s - tracks.readout_s, state.principal_px)


def scene_of(state: WindowState) -> Scene:
    """The views and the tracks of a state."""
    plane = _NO_PLANE if state.plane is None else state.plane
    return Scene(state.R, state.t, state.field, plane, state.on_plane, state.rays, state.inverse_distances)


class WindowEquations:
    """The equations of one window and one kind of hypothesis; holds the arrays that all steps share.

    * ``start``: Its plane says whether points may lie on a plane. The length of its longest baseline is held.
    * ``rotation_only``: Whether all points are at infinity.
    * ``with_shares``: Whether the share of each track in the gradient is wanted.
    * ``costs``: (T,) Cost of each track at the last state, with the cost of leaving the plane.
    * ``residuals``: (V, T, 2) Of each observation in units of the noise, at the last state; infinite behind a camera.
    * ``across``: (T,) Chance across the epipolar lines, see :func:`slam_init.window.kernels.accumulate`.
    * ``normal``: (G, G) The normal matrix of the last equations, with the scale free.
    * ``gradient``: (G,) Of the common unknowns, tracks eliminated.
    * ``shares``: (T, G) The share of each track in it; empty where they are not wanted.
    * ``back``: (T, 3, 4 + G) What the steps of the tracks need: gradient, inverse and coupling.
    * ``free``: (T,) Tracks whose inverse distance is an unknown.
    * ``focal``: Place of the focal length among the common unknowns. The distortion follows it, then the readout and
      the principal point where they are unknown.
    * ``held_view``: View whose baseline is held.
    """

    def __init__(
        self,
        tracks: WindowTracks,
        start: WindowState,
        priors: Priors,
        rotation_only: bool = False,
        *,
        with_shares: bool = True,
    ) -> None:
        self.tracks, self.priors, self.rotation_only = tracks, priors, rotation_only
        self._camera = camera_vector(tracks.camera)
        self._has_plane = start.plane is not None
        views, count = tracks.seen.shape
        self._layout = layout = Layout.of(
            views, field=priors.field_sigma_px > 0, readout=priors.readout_sigma_s > 0,
            principal=priors.principal_sigma_px > 0,
        )  # fmt: skip
        self.focal = layout.focal
        self._observed = observed_by(tracks, priors.gate_sigmas)
        self._equations = Equations.empty(count, layout.plane + 3 * self._has_plane, with_shares=with_shares)
        self.normal, self.gradient, self.shares, self.back, self._halves = self._equations
        self._fitted, self._sums = Fitted.empty(views, count), Sums.empty(views, len(self.gradient))
        self.free, self.costs, self.residuals, self.across = self._fitted
        self._pose_columns = np.arange(layout.field, layout.focal, layout.block)[:, None] + np.arange(6)
        self.held_view = int(np.argmax(np.linalg.norm(start.t, axis=1)))
        self._turned, self._levelled = bool(tracks.turned_weights.any()), bool(tracks.down_weights.any())
        self._used = tracks.anchor >= 0
        self._prior_weights = self._weights_of_priors()

    @property
    def squares(self) -> Floats:
        """Squared residual of each observation in units of the noise, at the last state.

        Shapes: returns (V, T).
        """
        return np.asarray(np.einsum("vtq,vtq->vt", self.residuals, self.residuals))

    def cost(self, state: WindowState) -> float:
        """Cost of a state: twice the negative logarithm of its posterior density, up to a constant."""
        return self._accumulate(state, fill=False)

    def build(self, state: WindowState, *, hold: bool = True) -> float:
        """Build the equations at a state.

        * ``hold``: Whether tracks at infinity whose distance would become negative are held there.
        """
        self.free[:] = not self.rotation_only
        return self._accumulate(state, fill=True, hold=hold)

    def stopped(self, state: WindowState) -> Bools:
        """The tracks at infinity whose distance would become negative, by the last equations.

        Shapes: returns (T,).
        """
        if self.rotation_only:
            return np.zeros(len(state.rays), bool)
        return np.asarray(~state.on_plane & (state.inverse_distances == 0) & (self.back[:, 2, 0] > 0))

    def turned_pulls(self, state: WindowState) -> Floats:
        """How far the views are turned from where they were measured to be.

        Shapes: returns (V, 3).

        * Returns: Rotation vectors in the cameras, in rad; the measured rotation is that of the vector before the
          state's.
        """
        off = state.R @ np.swapaxes(self.tracks.turned, 1, 2)
        return np.array([vector_from_rotation(R) for R in off])

    def turned_gradient(self, state: WindowState) -> Floats:
        """The part of the gradient that measured rotations and gravity make.

        Shapes: returns (G,).
        """
        gradient = np.zeros_like(self.gradient)
        if self._turned:
            pulls = self.tracks.turned_weights[1:, None] * self.turned_pulls(state)[1:]
            gradient[self._pose_columns[:, :3]] = pulls
        if self._levelled:
            self._add_gravity(state, gradient, None)
        return gradient

    def columns_of_fields(self) -> Bools:
        """Which common unknowns are coefficients of error fields.

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
        first = self._layout.field + self._layout.block * (self.held_view - 1) + 3
        own = slice(first, first + 3)
        along = state.t[self.held_view] / max(float(np.linalg.norm(state.t[self.held_view])), 1e-300)
        normal[own, own] += _GAUGE * max(1.0, float(normal[own, own].trace())) * np.outer(along, along)
        return normal

    def moved(self, state: WindowState, step: Floats, length: float = 1.0) -> WindowState:
        """The state after a step of the common unknowns, which the tracks follow by the last equations.

        Shapes: ``step`` (G,).
        """
        coupled = self.back.reshape(-1, self.back.shape[2])[:, 4:] @ step
        rays, inverse = step_tracks(
            self.back, coupled.reshape(-1, 3), length, state.rays, state.inverse_distances, self.free, state.on_plane,
            self._camera, np.array([state.log_scale, state.k1]), step[self.focal : self.focal + 2],
        )  # fmt: skip
        R, t, field = step_poses(step, length, self._layout.field, state.R, state.t, state.field)
        readout_s, principal_px = state.readout_s, state.principal_px
        if self._layout.readout:
            readout_s += length * float(step[self.focal + 2])
        if self._layout.principal:
            principal_px = principal_px + length * step[self._principal_columns]
        return WindowState(
            R=R,
            t=t,
            rays=rays,
            inverse_distances=inverse,
            log_scale=state.log_scale + length * float(step[self.focal]),
            k1=state.k1 + length * float(step[self.focal + 1]),
            readout_s=readout_s,
            principal_px=principal_px,
            field=field,
            plane=None if state.plane is None else state.plane + length * step[-3:],
            on_plane=state.on_plane,
        )

    def _accumulate(self, state: WindowState, *, fill: bool, hold: bool = False) -> float:
        cost = accumulate(
            self._observed, lens_of(self.tracks, state, self._camera), scene_of(state), self._layout, self._equations,
            self._fitted, self._sums, fill, hold,
        )  # fmt: skip
        if self._has_plane:
            off = self._used & ~state.on_plane
            self.costs[off] += OFF_PLANE_COST
            cost += OFF_PLANE_COST * int(np.count_nonzero(off))
        pulls = self._pulls(state)
        weighted = self._prior_weights * pulls
        cost += float(weighted @ pulls)
        if fill:
            eliminate(self.normal, self.gradient, self._halves)
            self.gradient += weighted
            self.normal.flat[:: len(weighted) + 1] += self._prior_weights
        if self._levelled:
            cost += (
                self._add_gravity(state, self.gradient, self.normal) if fill else self._add_gravity(state, None, None)
            )
        return cost

    def _add_gravity(self, state: WindowState, gradient: Floats | None, normal: Floats | None) -> float:
        """Add measured gravity to the equations; return its cost.

        A view that is turned about gravity sees it as before: two of three angles are measured. A measurement may be
        wrong, so that its weight falls with the angle that it is off by (Student's distribution).
        """
        seen = state.R[1:] @ self.tracks.down[0]
        pulls = np.cross(self.tracks.down[1:], seen)
        squares = self.tracks.down_weights[1:] * np.sum(pulls**2, axis=1)
        weights = self.tracks.down_weights[1:] * (_GRAVITY_TAIL + 2) / (_GRAVITY_TAIL + squares)
        for columns, weight, pull, down in zip(self._pose_columns[:, :3], weights, pulls, seen, strict=True):
            if gradient is not None:
                gradient[columns] += weight * pull
            if normal is not None:
                normal[np.ix_(columns, columns)] += weight * (np.eye(3) - np.outer(down, down))
        return float((_GRAVITY_TAIL + 2) * np.log1p(squares / _GRAVITY_TAIL).sum())

    def _weights_of_priors(self) -> Floats:
        """One over the variance of each common unknown before the tracks are seen."""
        priors, weights = self.priors, np.zeros(len(self.gradient))
        weights[self.focal], weights[self.focal + 1] = 1 / priors.focal_sigma**2, 1 / priors.k1_sigma**2
        if self._layout.readout:
            weights[self.focal + 2] = 1 / priors.readout_sigma_s**2
        if self._layout.principal:
            weights[self._principal_columns] = 1 / priors.principal_sigma_px**2
        if self._layout.field:
            weights[self.columns_of_fields()] = 1 / priors.field_sigma_px**2
        weights[self._pose_columns[:, :3]] += self.tracks.turned_weights[1:, None]
        return weights

    def _pulls(self, state: WindowState) -> Floats:
        """How far each common unknown is from what is expected of it; 0 where nothing is."""
        priors, pulls = self.priors, np.zeros(len(self.gradient))
        pulls[self.focal], pulls[self.focal + 1] = state.log_scale - priors.log_scale_mean, state.k1 - priors.k1_mean
        if self._layout.readout:
            pulls[self.focal + 2] = state.readout_s
        if self._layout.principal:
            pulls[self._principal_columns] = state.principal_px
        if self._layout.field:
            for k in range(len(self.tracks.seen)):
                pulls[self._field_columns(k)] = state.field[k]
        if self._turned:
            pulls[self._pose_columns[:, :3]] = self.turned_pulls(state)[1:]
        return pulls

    @property
    def _principal_columns(self) -> Ints:
        first = self.focal + 2 + self._layout.readout
        return np.arange(first, first + self._layout.principal)

    def _field_columns(self, view: int) -> Ints:
        first = self._layout.field + self._layout.block * (view - 1) + 6 if view else 0
        return np.arange(first, first + self._layout.field)


def explained_at_most(freedom: Ints) -> Floats:
    """The largest cost of a track that a motion explains.

    A track that neither of two motions explains must have the same cost with both. Otherwise outliers would vote, each
    one by chance but with a large weight. The bound is the mean of chi-square plus five of its standard deviations; one
    correct track in a thousand exceeds it.

    Shapes: ``freedom`` (T,), returns (T,).
    """
    return np.asarray(freedom + 5 * np.sqrt(2.0 * freedom))


def tangent_bases(rays: Floats) -> tuple[Floats, Floats]:
    """Two orthonormal vectors orthogonal to each ray, as :func:`quest.robust.kernels.small_algebra.tangents`.

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
