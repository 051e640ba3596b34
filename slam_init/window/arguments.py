"""The arguments of the compiled loops of the joint fit, in groups: named tuples, which the compiler takes apart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.vectors import Vector

#: Coefficients of the field of correlated errors of a view: 1, u, v, u^2, uv, v^2 for each component of the pixel.
FIELD_TERMS = 12
#: In place of a field, a view of a camera that rotates has the logarithm of its zoom, and its shift in pixels.
ZOOM_TERMS = 3


class Observed(NamedTuple):
    """The observations of the tracks that take part, track by track: the same at all states."""

    #: (N, 9) Measured pixel, one over the standard deviation in the direction in which the pixel is best known, the
    #: matrix that makes the noise equal in all directions (row by row, symmetric), and the derivative of the pixel by
    #: the readout. One record each, since reading them from arrays by view and track took as long as the arithmetic.
    records: Floats
    #: (N,) The view of each observation.
    views: Ints
    #: (T + 1,) The first observation of each track, and their number.
    first: Ints
    #: (V, T, 6) The polynomials of the field at the measured pixels, over sigma_px.
    places: Floats
    #: (T,) First view of a track; negative for a track that is left out.
    anchor: Ints
    #: The squared outlier gate.
    gate2: float


class LensNumbers(NamedTuple):
    """The lens of a state."""

    #: (31,) See :func:`slam_init.window.projection.camera_vector`.
    camera: Floats
    #: Logarithm of the true focal length over the stated one.
    log_scale: float
    k1: float
    #: Readout in seconds, beyond the one that the pixels are corrected for.
    readout_s: float
    #: (2,)
    principal_px: Floats


class Scene(NamedTuple):
    """The views and the tracks of a state."""

    #: R, t: (V, 3, 3), (V, 3)
    R: Floats
    t: Floats
    #: (V, 12) Of a field, or the zoom and the shift of a view.
    field: Floats
    #: (3,)
    plane: Floats
    #: (T,)
    on_plane: Bools
    #: (T, 3)
    rays: Floats
    #: (T,)
    inverse_distances: Floats


class Unknowns(NamedTuple):
    """A state, whose arrays receive the steps of a fit; which tracks are on the plane stays as it is."""

    scene: Scene
    #: (5,) Logarithm of the true focal length over the stated one, k1, readout in seconds, and principal point.
    lens: Floats

    @staticmethod
    def empty(views: int, on_plane: Bools) -> Unknowns:
        """Place for a number of views and for the tracks on the plane or off it (T,)."""
        scene = Scene(
            np.zeros((views, 3, 3)), np.zeros((views, 3)), np.zeros((views, FIELD_TERMS)), np.zeros(3), on_plane,
            np.zeros((len(on_plane), 3)), np.zeros(len(on_plane)),
        )  # fmt: skip
        return Unknowns(scene, np.zeros(5))


class Known(NamedTuple):
    """What is known before the tracks are seen."""

    #: (31,) See :func:`slam_init.window.projection.camera_vector`.
    camera: Floats
    #: Readout that the pixels are corrected for.
    corrected_s: float
    #: Whether all points are at infinity.
    at_infinity: bool
    #: (G,) One over the variance of each common unknown.
    weights: Floats
    #: (5,) What is expected of the lens, in the order of :attr:`Unknowns.lens`.
    lens: Floats
    #: turned, turned_weights: (V, 3, 3), (V,) Measured rotations of the views from the first one, and one over their
    #: variances, rad^-2; 0 where nothing was measured.
    turned: Floats
    turned_weights: Floats
    #: down, down_weights: (V, 3), (V,) Measured directions of gravity in the views, and one over their variances.
    down: Floats
    down_weights: Floats


class Layout(NamedTuple):
    """The order of the common unknowns."""

    #: Coefficients of the field of correlated errors of a view: none, or :data:`FIELD_TERMS`. :data:`ZOOM_TERMS` where
    #: the view zooms and shifts.
    field: int
    #: Whether the readout is an unknown, and the number of coordinates of the principal point that are.
    readout: int
    principal: int

    #: Unknowns of a pose: rotation vector and translation, or the rotation alone.
    pose: int
    #: Unknowns of a view: pose, then field. View 0 has a field and no pose.
    block: int
    #: Place of the focal length, and number of unknowns of the lens.
    focal: int
    lens: int
    #: Place of the plane, if it is an unknown.
    plane: int

    @staticmethod
    def of(views: int, *, field: int, readout: bool, principal: bool, rotation_only: bool = False) -> Layout:
        """The order for a number of views and for what is unknown; points at infinity show no translation."""
        pose = 3 if rotation_only else 6
        block = pose + field
        focal, lens = block * (views - 1) + field, 2 + readout + 2 * principal
        return Layout(field, int(readout), 2 * principal, pose, block, focal, lens, focal + lens)


class Equations(NamedTuple):
    """Receives the equations of a step with G common unknowns."""

    #: (G, G) The lower half of the equations of the common unknowns, before the tracks are eliminated. With tracks on
    #: the plane the last three unknowns are those of the plane.
    normal: Floats
    #: (G,)
    gradient: Floats
    #: (T, G) The share of each track in the gradient, the track eliminated; empty where the shares are not wanted.
    shares: Floats
    #: (T, 3, 4 + G) What the steps of the tracks need: gradient, inverse and coupling.
    back: Floats
    #: (T, 3, G + 1) Coupling and gradient of each track, over a root of its equations, for
    #: :func:`slam_init.window.track_equations.eliminate`.
    halves: Floats

    @staticmethod
    def empty(tracks: int, size: int, *, with_shares: bool = True) -> Equations:
        """Place for the equations of a number of tracks and of common unknowns."""
        return Equations(
            np.zeros((size, size)), np.zeros(size), np.zeros((tracks if with_shares else 0, size)),
            np.zeros((tracks, 3, 4 + size)), np.zeros((tracks, 3, size + 1)),
        )  # fmt: skip


class Work(NamedTuple):
    """Place for the solution of the equations."""

    #: (G, G) The upper half is factorized.
    factor: Floats
    #: (G,)
    step: Floats

    @staticmethod
    def empty(size: int) -> Work:
        """Place for G common unknowns."""
        return Work(np.zeros((size, size)), np.zeros(size))


class Limits(NamedTuple):
    """Where a fit ends, see :func:`slam_init.window.joint_fit.fit_window`."""

    max_steps: int
    tolerance: float
    hopeless: float
    give_up: float


class Fitted(NamedTuple):
    """Receives what a state makes of each track."""

    #: (T,) Tracks off the plane whose inverse distance is an unknown; those of the others are held.
    free: Bools
    #: (T,)
    costs: Floats
    #: (V, T, 2) The residual of each observation in units of the noise; infinite behind a camera.
    residuals: Floats
    #: (T,) How much the cost of a track with a free distance would fall if its point moved across its epipolar lines,
    #: in proportion to what a distance moves it along them. A rigid scene does not move so: this is chance.
    across: Floats

    @staticmethod
    def empty(views: int, tracks: int) -> Fitted:
        """Place for a number of views and tracks; all tracks are free."""
        return Fitted(np.ones(tracks, bool), np.zeros(tracks), np.zeros((views, tracks, 2)), np.zeros(tracks))


class Track(NamedTuple):
    """A track at a state."""

    i: int
    #: The view in which it is first seen.
    anchor: int
    #: Whether it is on the plane.
    flat: bool
    #: Inverse distance, and the point times it in the axes of the anchor: ``v = d - rho t_a``.
    rho: float
    v: Vector
    #: Unknowns of the ray: its tangents, and how the inverse distance follows them on a plane.
    x: Vector
    y: Vector
    by_x: float
    by_y: float
    #: 1 where the inverse distance is an unknown of its own, 0 otherwise.
    of_depth: float


class Row(NamedTuple):
    """An observation at a state: two equations. All derivatives are those of the residual in units of the noise."""

    #: Its place among the records, and its view.
    n: int
    k: int
    weight: float
    #: Weighted residual.
    h0: float
    h1: float
    #: Derivatives by the point in the axes of the view.
    a: Vector
    b: Vector
    #: M: the same in the axes of the anchor.
    c: Vector
    d: Vector
    #: Derivatives by the inverse distance.
    s0: float
    s1: float
    #: Derivatives by the unknowns of the track, then weighted.
    l0: Vector
    l1: Vector
    j0: Vector
    j1: Vector


class TrackSums(NamedTuple):
    """Sums over the observations of one track."""

    #: A, b: (3, 3), (3,) Equations of the unknowns of the track.
    A: Floats
    b: Floats
    #: (G,) Gradient by the common unknowns.
    share: Floats
    #: (3,) Derivatives by the point in the axes of the anchor, times the residuals.
    pulls: Floats
    #: (3, 3) The unknowns of the track by the point.
    coupled: Floats
    #: (2,) Gradient and curvature by the depth of a track on a plane.
    depth: Floats
    #: by_depth, by_lens: (3,), (5,) Products of this depth with the unknowns of the track and with the lens.
    by_depth: Floats
    by_lens: Floats
    #: (2,) Slope and curvature of the cost across the epipolar lines.
    across: Floats
    #: (2, 5) Derivatives of the residual of the last observation by the lens.
    lens: Floats
    #: (12,) Derivatives of the inverse distance on the plane: by the plane, by the ray, by the pose of the anchor.
    by: Floats

    @staticmethod
    def empty(size: int) -> TrackSums:
        """Place for G common unknowns."""
        return TrackSums(
            np.zeros((3, 3)), np.zeros(3), np.zeros(size), np.zeros(3), np.zeros((3, 3)), np.zeros(2), np.zeros(3),
            np.zeros(5), np.zeros(2), np.zeros((2, 5)), np.zeros(12),
        )  # fmt: skip


class PairSums(NamedTuple):
    """Sums over the tracks of each anchor and view, see :mod:`slam_init.window.pair_sums`."""

    #: (V, V, 9) Rotations ``R_k R_a^T``, row by row.
    turn: Floats
    #: (V, V, 3) Derivatives of points by their inverse distances, in the axes of the anchor.
    shift: Floats
    #: (V, V, 21) ``B^T M^T M B``: rotation by rotation (lower half), rotation by translation (row by row), translation
    #: by translation (lower half).
    pose: Floats
    #: (V, V, 5, 6) ``B^T z`` with the product z of the derivatives by the point and by an unknown of the lens.
    lens: Floats
    #: (V, V, 9, 6) ``c (B^T M s)^T``: by the plane, then by the pose of the anchor.
    plane: Floats

    @staticmethod
    def empty(views: int) -> PairSums:
        """Place for a number of views."""
        turn, shift, pose = np.zeros((views, views, 9)), np.zeros((views, views, 3)), np.zeros((views, views, 21))
        return PairSums(turn, shift, pose, np.zeros((views, views, 5, 6)), np.zeros((views, views, 9, 6)))


class TurnedSums(NamedTuple):
    """The sums of an anchor and a view, with the derivatives by the pose of the view in the axes of the view."""

    #: (6, 6) The rotation from the anchor into the view, for rotation vector and translation.
    Q: Floats
    #: (6, 6) ``B^T M^T M B``, not turned.
    own: Floats
    #: (6, 6) ``Q B^T M^T M B``.
    half: Floats
    #: (6, 9) ``Q B^T M s c^T``.
    bent: Floats


class Sums(NamedTuple):
    """Place for the sums from which the equations are made: the loop makes no arrays."""

    track: TrackSums
    pairs: PairSums
    turned: TurnedSums

    @staticmethod
    def empty(views: int, size: int) -> Sums:
        """Place for a number of views and for G common unknowns."""
        turned = TurnedSums(np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 9)))
        return Sums(TrackSums.empty(size), PairSums.empty(views), turned)
