"""The equations of a joint fit: cost, Gauss-Newton equations with the tracks eliminated, and the state after a step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quest.geometry.quaternion import vector_from_rotation
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.kernels import FIELD_TERMS, accumulate, eliminate, step_tracks
from slam_init.window.projection import camera_vector
from slam_init.window.state import Priors, WindowState
from slam_init.window.tracks import WindowTracks
from slam_init.work import Prices, spend

__all__ = ["OFF_PLANE_COST", "WindowEquations", "explained_at_most", "tangent_bases"]

#: Cost of a track that leaves the plane: three nats, as much as a track may vote for or against a hypothesis.
OFF_PLANE_COST = 6.0
#: Stiffness of the held baseline over that of its view.
_GAUGE = 1e4


class WindowEquations:
    """The equations of one window and one kind of hypothesis; holds the arrays that all steps share.

    Parameters
    ----------
    tracks : WindowTracks
    start : WindowState
        Its plane says whether points may lie on a plane. The length of its longest baseline is held.
    priors : Priors
    rotation_only : bool
        Whether all points are at infinity.

    Attributes
    ----------
    tracks : WindowTracks
    priors : Priors
    rotation_only : bool
    costs : (T,) float
        Cost of each track at the last state, with the cost of leaving the plane.
    residuals : (V, T, 2) float
        Of each observation in units of the noise, at the last state; infinite behind a camera.
    across : (T,) float
        Chance across the epipolar lines, see :func:`slam_init.window.kernels.accumulate`.
    gradient : (G,) float
        Of the common unknowns, tracks eliminated.
    shares : (T, G) float
        The share of each track in it.
    back : (T, 3, 4 + G) float
        What the steps of the tracks need: gradient, inverse and coupling.
    free : (T,) bool
        Tracks whose inverse distance is an unknown.
    focal : int
        Place of the focal length among the common unknowns. The distortion follows it, then the readout and the
        principal point where they are unknown.
    held_view : int
        View whose baseline is held.
    """

    def __init__(self, tracks: WindowTracks, start: WindowState, priors: Priors, rotation_only: bool = False) -> None:
        self.tracks, self.priors, self.rotation_only = tracks, priors, rotation_only
        self._camera = camera_vector(tracks.camera)
        self._has_plane = start.plane is not None
        self._field_size = FIELD_TERMS if priors.field_sigma_px > 0 else 0
        views, count = tracks.seen.shape
        self._views = views
        self._block = 6 + self._field_size
        self.focal = self._block * (views - 1) + self._field_size
        self._readout_size = 1 if priors.readout_sigma_s > 0 else 0
        self._principal_size = 2 if priors.principal_sigma_px > 0 else 0
        size = self.focal + 2 + self._readout_size + self._principal_size + (3 if self._has_plane else 0)
        self._normal, self.gradient, self.shares = np.zeros((size, size)), np.zeros(size), np.zeros((count, size))
        self.back, self.costs = np.zeros((count, 3, 4 + size)), np.zeros(count)
        self.residuals, self.across = np.zeros((views, count, 2)), np.zeros(count)
        firsts = self._field_size + self._block * np.arange(views - 1)
        self._pose_columns = firsts[:, None] + np.arange(6)
        self.held_view = int(np.argmax(np.linalg.norm(start.t, axis=1)))
        self.free = np.ones(count, bool)
        self._turned = bool(tracks.turned_weights.any())
        self._observations = int(tracks.seen[:, tracks.anchor >= 0].sum())

    @property
    def normal(self) -> Floats:
        """The normal matrix of the last equations, with the scale free.

        Returns
        -------
        (G, G) float
        """
        return self._normal

    @property
    def squares(self) -> Floats:
        """Squared residual of each observation in units of the noise, at the last state.

        Returns
        -------
        (V, T) float
            Infinite behind a camera.
        """
        return np.asarray(np.einsum("vtq,vtq->vt", self.residuals, self.residuals))

    def cost(self, state: WindowState) -> float:
        """Cost of a state: twice the negative logarithm of its posterior density, up to a constant.

        Parameters
        ----------
        state : WindowState

        Returns
        -------
        float
        """
        return self._accumulate(state, fill=False)

    def build(self, state: WindowState, *, hold: bool = True) -> float:
        """Build the equations at a state.

        Parameters
        ----------
        state : WindowState
        hold : bool
            Whether tracks at infinity whose distance would become negative are held there.

        Returns
        -------
        float
            The cost.
        """
        self.free[:] = not self.rotation_only
        return self._accumulate(state, fill=True, hold=hold)

    def stopped(self, state: WindowState) -> Bools:
        """The tracks at infinity whose distance would become negative, by the last equations.

        Parameters
        ----------
        state : WindowState

        Returns
        -------
        (T,) bool
        """
        if self.rotation_only:
            return np.zeros(len(state.rays), bool)
        return np.asarray(~state.on_plane & (state.inverse_distances == 0) & (self.back[:, 2, 0] > 0))

    def turned_pulls(self, state: WindowState) -> Floats:
        """How far the views are turned from where they were measured to be.

        Parameters
        ----------
        state : WindowState

        Returns
        -------
        (V, 3) float
            Rotation vectors in the cameras, in rad; the measured rotation is that of the vector before the state's.
        """
        off = state.R @ np.swapaxes(self.tracks.turned, 1, 2)
        return np.array([vector_from_rotation(R) for R in off])

    def turned_gradient(self, state: WindowState) -> Floats:
        """The part of the gradient that measured rotations make.

        Parameters
        ----------
        state : WindowState

        Returns
        -------
        (G,) float
        """
        gradient = np.zeros_like(self.gradient)
        if self._turned:
            pulls = self.tracks.turned_weights[1:, None] * self.turned_pulls(state)[1:]
            gradient[self._pose_columns[:, :3]] = pulls
        return gradient

    def columns_of_fields(self) -> Bools:
        """Which common unknowns are coefficients of error fields.

        Returns
        -------
        (G,) bool
        """
        columns = np.zeros(len(self.gradient), bool)
        for k in range(self._views):
            columns[self._field_columns(k)] = True
        return columns

    def information(self, state: WindowState) -> Floats:
        """The normal matrix of the last equations with the length of one baseline held.

        Parameters
        ----------
        state : WindowState

        Returns
        -------
        (G, G) float
        """
        normal = self._normal.copy()
        first = self._field_size + self._block * (self.held_view - 1) + 3
        own = slice(first, first + 3)
        along = state.t[self.held_view] / max(float(np.linalg.norm(state.t[self.held_view])), 1e-300)
        normal[own, own] += _GAUGE * max(1.0, float(np.trace(normal[own, own]))) * np.outer(along, along)
        return normal

    def moved(self, state: WindowState, step: Floats, length: float = 1.0) -> WindowState:
        """The state after a step of the common unknowns, which the tracks follow by the last equations.

        Parameters
        ----------
        state : WindowState
        step : (G,) float
        length : float
            Factor on the steps of all unknowns.

        Returns
        -------
        WindowState
        """
        free = self.free & ~state.on_plane
        rays, inverse = step_tracks(self.back, step, length, state.rays, state.inverse_distances, free)
        step = length * step
        R, t, field = state.R.copy(), state.t.copy(), state.field.copy()
        poses = step[self._pose_columns]
        R[1:] = _rotations(poses[:, :3]) @ R[1:]
        t[1:] += poses[:, 3:]
        if self._field_size:
            for k in range(self._views):
                field[k] += step[self._field_columns(k)]
        plane = None if state.plane is None else state.plane + step[-3:]
        readout_s = state.readout_s + (float(step[self.focal + 2]) if self._readout_size else 0.0)
        principal_px = state.principal_px + (step[self._principal_columns] if self._principal_size else 0.0)
        return replace(
            state,
            R=R,
            t=t,
            rays=rays,
            inverse_distances=inverse,
            log_scale=state.log_scale + float(step[self.focal]),
            k1=state.k1 + float(step[self.focal + 1]),
            readout_s=readout_s,
            principal_px=principal_px,
            field=field,
            plane=plane,
        )

    def _accumulate(self, state: WindowState, *, fill: bool, hold: bool = False) -> float:
        tracks, priors = self.tracks, self.priors
        if fill:
            spend(Prices.EQUATIONS + Prices.EQUATIONS_OBSERVATION * self._observations)
        else:
            spend(Prices.COST + Prices.COST_OBSERVATION * self._observations)
        plane = np.zeros(3) if state.plane is None else state.plane
        readout_s = state.readout_s - tracks.readout_s
        cost = accumulate(
            self._camera, state.R, state.t, state.log_scale, state.k1, plane, state.on_plane, state.field,
            self._field_size, readout_s, self._readout_size, state.principal_px, self._principal_size,
            tracks.sweep_px_s, tracks.pixels, tracks.sigma_px, tracks.whitening, tracks.places, tracks.seen,
            tracks.anchor, state.rays, state.inverse_distances, self.free,
            priors.gate_sigmas**2, self._normal, self.shares, self.back, self.costs, self.residuals, self.across,
            fill, hold,
        )  # fmt: skip
        if self._has_plane:
            off = ~state.on_plane & (tracks.anchor >= 0)
            self.costs[off] += OFF_PLANE_COST
            cost += OFF_PLANE_COST * float(off.sum())
        by_focal, by_k1 = priors.lens_pulls(state)
        cost += by_focal**2 + by_k1**2
        if fill:
            self.gradient[:] = eliminate(self._normal, self.shares, self.back)
            self._normal[self.focal, self.focal] += 1 / priors.focal_sigma**2
            self.gradient[self.focal] += by_focal / priors.focal_sigma
            self._normal[self.focal + 1, self.focal + 1] += 1 / priors.k1_sigma**2
            self.gradient[self.focal + 1] += by_k1 / priors.k1_sigma
        if self._readout_size:
            cost += (state.readout_s / priors.readout_sigma_s) ** 2
            if fill:
                self._normal[self.focal + 2, self.focal + 2] += 1 / priors.readout_sigma_s**2
                self.gradient[self.focal + 2] += state.readout_s / priors.readout_sigma_s**2
        if self._principal_size:
            cost += float(np.sum(state.principal_px**2)) / priors.principal_sigma_px**2
            if fill:
                own = self._principal_columns
                self._normal[own, own] += 1 / priors.principal_sigma_px**2
                self.gradient[own] += state.principal_px / priors.principal_sigma_px**2
        if self._turned:
            weights, pulls = tracks.turned_weights, self.turned_pulls(state)
            cost += float(weights @ np.einsum("vi,vi->v", pulls, pulls))
            if fill:
                columns = self._pose_columns[:, :3]
                self._normal[columns, columns] += weights[1:, None]
                self.gradient[columns] += weights[1:, None] * pulls[1:]
        if self._field_size:
            cost += float(np.sum(state.field**2)) / priors.field_sigma_px**2
            for k in range(self._views if fill else 0):
                own = self._field_columns(k)
                self._normal[own, own] += 1 / priors.field_sigma_px**2
                self.gradient[own] += state.field[k] / priors.field_sigma_px**2
        return cost

    @property
    def _principal_columns(self) -> Ints:
        first = self.focal + 2 + self._readout_size
        return np.arange(first, first + self._principal_size)

    def _field_columns(self, view: int) -> Ints:
        first = self._field_size + self._block * (view - 1) + 6 if view else 0
        return np.arange(first, first + self._field_size)


def explained_at_most(freedom: Ints) -> Floats:
    """The largest cost of a track that a motion explains.

    A track that neither of two motions explains must have the same cost with both. Otherwise outliers would vote, each
    one by chance but with a large weight. The bound is the mean of chi-square plus five of its standard deviations; one
    correct track in a thousand exceeds it.

    Parameters
    ----------
    freedom : (T,) int
        Degrees of freedom of each track.

    Returns
    -------
    (T,) float
    """
    return np.asarray(freedom + 5 * np.sqrt(2.0 * freedom))


def _rotations(vectors: Floats) -> Floats:
    """Rotation matrices (V, 3, 3) of rotation vectors (V, 3): the formula of Rodrigues."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = vectors.T
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = z, -y, x
    sine, versine = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


def tangent_bases(rays: Floats) -> tuple[Floats, Floats]:
    """Two orthonormal vectors orthogonal to each ray, as :func:`quest.robust.kernels.small_algebra.tangents`.

    Parameters
    ----------
    rays : (T, 3) float
        Unit vectors.

    Returns
    -------
    first, second : (T, 3) float
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
