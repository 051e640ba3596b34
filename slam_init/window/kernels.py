"""The compiled loop of the joint fit: residuals, their derivatives, and the elimination of the tracks.

It is written once for every hypothesis. A track is seen first by its anchor view ``a``. There it has a true unit ray
``d``, and an inverse distance ``rho`` along this ray, which is 0 at infinity. Its point, scaled by ``rho``, is in view
k ::

    P = R_k R_a^T (d - rho t_a) + rho t_k          R_k, t_k = cam_k_from_world

and the residual in units of the noise is, with the projection pi of the lens and a measured pixel x ::

    e = W ((pi(P; focal scale, k1) + p + S r - x) / sigma + F(x) c_k)

``F(x) c_k`` is the smooth field of correlated errors of view k: six polynomials of the image coordinates for each
component, with coefficients c_k. View 0 is a measurement like any other, so its rays have residuals too.

``r`` is the readout of a rolling shutter in seconds, and ``S`` how far the pixel moves for each second of it
(:mod:`slam_init.frontend.rolling_shutter`). The poses are those of the middle of the readout. ``p`` is the error of the
principal point, where it is unknown. ``W`` makes the noise of a pixel equal in all directions: a track slides along the
trails of a blurred image.

On a plane ``k . X = 1`` the inverse distance of a track is no unknown: ``rho = (k . u) / (1 - k . c)`` with ``u =
R_a^T d`` and the centre ``c = -R_a^T t_a`` of the anchor. A point with ``rho <= 0`` lies behind its camera: all its
observations count as outliers then.

Each observation has the robust cost ``g (1 - (1 - e^2 / 3g)^3)`` up to ``e^2 = 3g``, and g beyond (Tukey's biweight), g
the squared outlier gate. Near 0 it is e^2, and 95 % of the information of Gaussian noise is kept at a gate of three
standard deviations; the kernel of Geman and McClure with the same cost of an outlier keeps 57 %. Each track
adds two or three unknowns of its own: two of its ray, and rho. :func:`.track_equations.eliminate` takes them out (Schur
complement), so that a step solves for the views, the camera and the plane only. The order of the unknowns is: field of
view 0; pose (rotation vector, translation) and field of views 1, 2, ...; logarithm of the focal scale; k1, which is
added to the first coefficient of the radial distortion; readout, where it is unknown; principal point, where it is
unknown; plane.

Let ``M`` be the derivatives of a residual by the point in the axes of the anchor, and ``v = d - rho t_a``. The
derivatives by the pose of view k, turned into the axes of the anchor, are ``M B`` with ``B = [-[v]x, rho I]``. Those by
the pose of the anchor are ``-M B``. ``B`` is the same in all views of a track. So each pair of anchor and view has sums
over its tracks (:mod:`slam_init.window.pair_sums`), which are turned into the view once.

The loop reads as the equations do: an observation is projected (:func:`_residual`), weighted, and differentiated
(:func:`_row`). Its row joins the sums of its track (:mod:`slam_init.window.track_equations`), of its anchor and view
(:mod:`slam_init.window.pair_sums`), and those of the lens and of the field of correlated errors of its view
(:mod:`slam_init.window.shared_unknowns`).
"""

from __future__ import annotations

import numpy as np

from quest.algebra import tangents
from quest.jit import inlined
from slam_init.window.arguments import (
    ZOOM_TERMS,
    Equations,
    Fitted,
    Layout,
    LensNumbers,
    Observed,
    PairSums,
    Row,
    Scene,
    Sums,
    Track,
    TrackSums,
)
from slam_init.window.compiler import compiled
from slam_init.window.pair_sums import add_depth, add_pose, assemble, clear_pairs, to_anchor
from slam_init.window.projection import project_point
from slam_init.window.shared_unknowns import add_field, add_lens, differentiate_lens, whitening
from slam_init.window.track_equations import (
    add_row,
    clear_track,
    couple_anchor,
    couple_plane,
    couple_view,
    depth_on_plane,
    finish_track,
    hold_at_infinity,
)
from slam_init.window.vectors import Vector, dot, joint, to_view, to_world, vector_of

#: An observation whose square is this many squared gates has no influence. With 3 the cost of a small residual is its
#: square.
TUKEY_GATES = 3.0


@compiled
def accumulate(
    observed: Observed,
    lens: LensNumbers,
    scene: Scene,
    layout: Layout,
    equations: Equations,
    fitted: Fitted,
    sums: Sums,
    fill: bool,
    hold: bool,
) -> float:
    """Robust cost of all observations, and with ``fill`` the equations of a Gauss-Newton step.

    * ``hold``: Tracks at infinity whose distance would become negative are held from here on.
    """
    if fill:
        equations.normal[:], equations.gradient[:] = 0.0, 0.0
        clear_pairs(scene, sums.pairs)
    total, flats = _add_tracks(observed, lens, scene, layout, equations, fitted, sums.pairs, sums.track, fill, hold)
    if fill:
        assemble(layout, sums.pairs, flats, sums.turned, equations.normal)
    return total


@inlined
def _add_tracks(
    observed: Observed,
    lens: LensNumbers,
    scene: Scene,
    layout: Layout,
    equations: Equations,
    fitted: Fitted,
    pairs: PairSums,
    sums: TrackSums,
    fill: bool,
    hold: bool,
) -> tuple[float, bool]:
    """Robust cost of all tracks, and whether one is on the plane; with ``fill`` each one joins the equations."""
    total, flats, scale = 0.0, False, np.exp(lens.log_scale)
    for i in range(len(observed.anchor)):
        fitted.costs[i] = 0.0
        if fill:
            fitted.across[i] = 0.0
            clear_track(i, equations, sums)
        if observed.anchor[i] < 0:
            continue
        track = _track(i, observed, scene, fitted, sums)
        flats |= track.flat
        cost = _observe(track, observed, lens, scale, scene, layout, equations, fitted, pairs, sums, fill)
        fitted.costs[i] = cost
        total += cost
        if not fill:
            continue
        slope, curvature = sums.across[0], sums.across[1]
        fitted.across[i] = slope * slope / curvature if curvature > 0.0 else 0.0
        if hold:
            hold_at_infinity(track, equations, fitted, sums)
        if track.anchor > 0:
            couple_anchor(track, layout, equations, sums)
        if track.flat:
            couple_plane(track, layout, equations, sums)
        finish_track(track, fitted.free[i], equations, sums)
    return total, flats


@inlined
def _track(i: int, observed: Observed, scene: Scene, fitted: Fitted, sums: TrackSums) -> Track:
    """The ray, the inverse distance and the point of a track, and how they follow its unknowns."""
    a, flat, ray = observed.anchor[i], scene.on_plane[i], scene.rays[i]
    d = vector_of(scene.rays, i)
    rho = depth_on_plane(scene.R, scene.t, a, d, scene.plane, sums.by) if flat else scene.inverse_distances[i]
    x0, x1, x2, y0, y1, y2 = tangents(ray)
    x, y = (x0, x1, x2), (y0, y1, y2)
    by_x, by_y = 0.0, 0.0
    if flat:
        by_ray = (sums.by[3], sums.by[4], sums.by[5])
        by_x, by_y = dot(by_ray, x), dot(by_ray, y)
    of_depth = 1.0 if fitted.free[i] and not flat else 0.0
    v = (d[0] - rho * scene.t[a, 0], d[1] - rho * scene.t[a, 1], d[2] - rho * scene.t[a, 2])
    return Track(i, a, flat, rho, v, x, y, by_x, by_y, of_depth)


@inlined
def _observe(
    track: Track,
    observed: Observed,
    lens: LensNumbers,
    focal_scale: float,
    scene: Scene,
    layout: Layout,
    equations: Equations,
    fitted: Fitted,
    pairs: PairSums,
    sums: TrackSums,
    fill: bool,
) -> float:
    """Robust cost of the observations of a track; with ``fill`` each one joins all sums."""
    i, a, rho, gate2 = track.i, track.anchor, track.rho, observed.gate2
    behind, share_gate, cost = track.flat and rho <= 0.0, 1.0 / (TUKEY_GATES * gate2), 0.0
    Y = to_world(scene.R, a, track.v)
    for n in range(observed.first[i], observed.first[i + 1]):
        k = observed.views[n]
        z = to_view(scene.R, k, Y)
        zoom = np.exp(scene.field[k, 0]) if layout.field == ZOOM_TERMS else 1.0
        sees, px, py, a0, a1, a2, b0, b1, b2, f0, f1 = project_point(
            lens.camera, focal_scale * zoom, lens.k1,
            z[0] + rho * scene.t[k, 0], z[1] + rho * scene.t[k, 1], z[2] + rho * scene.t[k, 2],
        )  # fmt: skip
        if behind or not sees:
            cost += gate2
            fitted.residuals[k, i, 0] = fitted.residuals[k, i, 1] = np.inf
            continue
        e0, e1 = _residual(n, k, i, px, py, observed, lens, scene, layout)
        fitted.residuals[k, i, 0], fitted.residuals[k, i, 1] = e0, e1
        left = max(1.0 - (e0 * e0 + e1 * e1) * share_gate, 0.0)
        cost += gate2 * (1.0 - left * left * left)
        if not fill or left == 0.0:
            continue
        row = _row(n, k, left * left, e0, e1, (a0, a1, a2), (b0, b1, b2), track, observed, pairs)
        add_row(row, sums)
        differentiate_lens(n, px - lens.camera[3], py - lens.camera[4], f0, f1, observed, layout, sums.lens)
        add_lens(track, row, layout, equations, pairs, sums)
        if k != a:
            add_pose(track, row, pairs, sums)
            if track.flat:
                add_depth(track, row, pairs, sums)
        if k > 0:
            couple_view(track, row, z, layout, equations, sums)
        if layout.field:
            add_field(track, row, observed, layout, equations, pairs.turn, sums)
    return cost


@inlined
def _residual(
    n: int, k: int, i: int, px: float, py: float, observed: Observed, lens: LensNumbers, scene: Scene, layout: Layout
) -> tuple[float, float]:
    """The residual of an observation in units of the noise, from the projection of its point."""
    records, half = observed.records, layout.field // 2
    inverse = records[n, 2]
    g0 = (px + lens.principal_px[0] + lens.readout_s * records[n, 7] - records[n, 0]) * inverse
    g1 = (py + lens.principal_px[1] + lens.readout_s * records[n, 8] - records[n, 1]) * inverse
    if layout.field == ZOOM_TERMS:
        g0, g1, half = g0 + scene.field[k, 1] * inverse, g1 + scene.field[k, 2] * inverse, 0
    for q in range(half):
        g0 += observed.places[k, i, q] * scene.field[k, q]
        g1 += observed.places[k, i, q] * scene.field[k, half + q]
    return records[n, 3] * g0 + records[n, 4] * g1, records[n, 5] * g0 + records[n, 6] * g1


@inlined
def _row(
    n: int,
    k: int,
    weight: float,
    e0: float,
    e1: float,
    a: Vector,
    b: Vector,
    track: Track,
    observed: Observed,
    pairs: PairSums,
) -> Row:
    """The equations of an observation, from its residual and the derivatives a, b of its pixel by the point."""
    w00, w01, w10, w11 = whitening(n, observed.records)
    a, b = joint(a, b, w00, w01), joint(a, b, w10, w11)
    c, d = to_anchor(pairs.turn, track.anchor, k, a), to_anchor(pairs.turn, track.anchor, k, b)
    s0, s1 = 0.0, 0.0
    if k != track.anchor:
        shift = (pairs.shift[track.anchor, k, 0], pairs.shift[track.anchor, k, 1], pairs.shift[track.anchor, k, 2])
        s0, s1 = dot(c, shift), dot(d, shift)
    x, y, by_x, by_y = track.x, track.y, track.by_x, track.by_y
    l0 = (dot(c, x) + s0 * by_x, dot(c, y) + s0 * by_y, s0 * track.of_depth)
    l1 = (dot(d, x) + s1 * by_x, dot(d, y) + s1 * by_y, s1 * track.of_depth)
    j0, j1 = (weight * l0[0], weight * l0[1], weight * l0[2]), (weight * l1[0], weight * l1[1], weight * l1[2])
    return Row(n, k, weight, weight * e0, weight * e1, a, b, c, d, s0, s1, l0, l1, j0, j1)
