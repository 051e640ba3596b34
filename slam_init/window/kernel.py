"""The compiled loop of the joint fit: residuals and their derivatives.

It is written once for every hypothesis. A track is seen first by its anchor view ``a``. There it has a true unit ray
``d``, and an inverse distance ``rho`` along this ray, which is 0 at infinity. Its point times ``rho``, in the axes of
the world from the origin on, and the same point in view k are ::

    X = R_a^T (d - rho t_a)          P = R_k X + rho t_k          R_k, t_k = cam_k_from_world

and the residual in units of the noise is, with the projection pi of the lens and a measured pixel x ::

    e = W (pi(P; focal scale, k1) + p + S r + F(x) c_k - x)

``F(x) c_k`` is the smooth field of correlated errors of view k: six polynomials of the image coordinates for each
component, with coefficients c_k. View 0 is a measurement like any other, so its rays have residuals too.

``r`` is the readout of a rolling shutter in seconds, and ``S`` how far the pixel moves for each second of it
(:mod:`slam_init.frontend.rolling_shutter`). The poses are those of the middle of the readout. ``p`` is the error of the
principal point, where it is unknown. ``W`` makes the noise of a pixel equal to 1 in all directions: a track slides
along the trails of a blurred image.

On a plane ``k . X = 1`` the inverse distance of a track is no unknown: ``rho = (k . u) / (1 - k . c)`` with ``u =
R_a^T d`` and the centre ``c = -R_a^T t_a`` of the anchor. A point with ``rho <= 0`` lies behind its camera: all its
observations count as outliers then.

Each observation has the robust cost ``g (1 - (1 - e^2 / 3g)^3)`` up to ``e^2 = 3g``, and g beyond (Tukey's biweight), g
the squared outlier gate. Near 0 it is e^2, and 95 % of the information of Gaussian noise is kept at a gate of three
standard deviations; the kernel of Geman and McClure with the same cost of an outlier keeps 57 %. Each track
adds two or three unknowns of its own: two of its ray, and rho. They are taken out (:mod:`.elimination`), so that a step
solves for the views, the camera and the plane only. The order of the unknowns is: field of view 0; pose (rotation
vector, translation) and field of views 1, 2, ...; logarithm of the focal scale; k1, which is added to the first
coefficient of the radial distortion; readout, where it is unknown; principal point, where it is unknown; plane.

Poses move in the axes of the world until all is summed. With the derivatives c of a residual by X, those by the pose of
view k are ``(X x c, rho c)`` then, and those by the pose of the anchor are the same with the other sign.
:func:`.elimination.turn_into_views` turns the sums into the axes of the views.
"""

from __future__ import annotations

import numpy as np

from quest.algebra import tangents
from quest.jit import inlined
from slam_init.lenses.point import project_point, radial_and_tangential
from slam_init.types.arrays import Floats
from slam_init.window import arguments as at
from slam_init.window.arguments import (
    FIELD_TERMS,
    LANES,
    ZOOM_TERMS,
    Equations,
    Known,
    Layout,
    Observed,
    Problem,
    Room,
    Unknowns,
)
from slam_init.window.compiler import Vector, compiled, dot, part, to_view, to_world, vector_of
from slam_init.window.elimination import clear, couple, eliminate, list_columns, solve_tracks, turn_into_views
from slam_init.window.levels import LARGEST_VOTE

#: An observation whose square is this many squared gates has no influence. With 3 the cost of a small residual is its
#: square.
TUKEY_GATES = 3.0
#: Cost of a track that leaves the plane: as much as a track may vote for or against a hypothesis.
OFF_PLANE_COST = LARGEST_VOTE


@compiled
def evaluate(
    problem: Problem, state: Unknowns, equations: Equations, room: Room, fill: bool, hold: bool, record: bool
) -> float:
    """Cost of a state: twice the negative logarithm of its posterior density, up to a constant.

    * ``fill``: Whether the equations of a Gauss-Newton step are filled in.
    * ``hold``: Tracks at infinity whose distance would become negative are held from here on.
    * ``record``: Whether the residuals are recorded.
    """
    observed, known, layout = problem.observed, problem.known, problem.layout
    has_plane = len(equations.gradient) > layout.plane
    off_plane = OFF_PLANE_COST if has_plane else 0.0
    total, views, w = 0.0, len(state.R), room.tracks
    if fill:
        clear(equations)
    for b in range(len(observed.tracks)):
        _load(b, observed, known, state, w)
        for k in range(views):
            n, any_seen = b * views + k, 0.0
            for lane in range(LANES):
                any_seen += observed.rows[n, at.SEEN + lane]
            if any_seen == 0.0:
                continue
            _project(k, known.camera, layout, state, w, room.projected)
            _weigh(n, k, observed, known, layout, state, w, room.projected)
            for lane in range(observed.counts[b] if record else 0):
                i, place = observed.tracks[b, lane], at.RESIDUAL[0] + lane
                if observed.rows[n, at.SEEN + lane] > 0.0:
                    sees = room.projected[at.SEES + lane] > 0.0
                    equations.residuals[k, i, 0] = room.projected[place] if sees else np.inf
                    equations.residuals[k, i, 1] = room.projected[place + LANES] if sees else np.inf
            if fill:
                _differentiate(n, k, observed.anchors[b], observed, layout, state, room)
                count = list_columns(k, observed.anchors[b], has_plane, layout, room)
                couple(b, count, room, equations)
        for lane in range(observed.counts[b]):
            cost = w[at.COST + lane] + off_plane * (1.0 - w[at.ON_PLANE + lane])
            equations.costs[observed.tracks[b, lane]] = cost
            total += cost
        if fill:
            solve_tracks(b, hold, observed, w, equations)
            eliminate(b, w, equations, room.halves)
    if fill:
        turn_into_views(layout, state.R, equations)
    return total + add_priors(known, state, layout, equations, fill)


@part
def _load(b: int, observed: Observed, known: Known, state: Unknowns, w: Floats) -> None:
    """Rays, inverse distances and points of a block of tracks, and how they follow their unknowns."""
    a, R, t = observed.anchors[b], state.R, state.t
    c0, c1, c2 = to_world(R, a, (-t[a, 0], -t[a, 1], -t[a, 2]))
    n0, n1, n2 = state.plane[0], state.plane[1], state.plane[2]
    over = 1.0 / (1.0 - (n0 * c0 + n1 * c1 + n2 * c2))
    for row in range(at.BY_PLANE[0], at.ROOT[0]):
        w[row] = 0.0
    for lane in range(LANES):
        i = observed.tracks[b, lane]
        u0, u1, u2 = to_world(R, a, vector_of(state.rays, i))
        x0, x1, x2, y0, y1, y2 = tangents(state.rays[i])
        x0, x1, x2 = to_world(R, a, (x0, x1, x2))
        y0, y1, y2 = to_world(R, a, (y0, y1, y2))
        rho, by_x, by_y = state.inverse_distances[i], 0.0, 0.0
        if state.on_plane[i]:
            rho = (n0 * u0 + n1 * u1 + n2 * u2) * over
            by_x, by_y = (n0 * x0 + n1 * x1 + n2 * x2) * over, (n0 * y0 + n1 * y1 + n2 * y2) * over
            # By the plane; by the anchor, whose rotation w moves u by u x w and c by c x w, and its shift moves c.
            f = rho * over
            p0, p1, p2 = u0 * over + f * c0, u1 * over + f * c1, u2 * over + f * c2
            w[at.BY_PLANE[0] + lane], w[at.BY_PLANE[1] + lane], w[at.BY_PLANE[2] + lane] = p0, p1, p2
            w[at.BY_ANCHOR[0] + lane] = n1 * p2 - n2 * p1
            w[at.BY_ANCHOR[1] + lane] = n2 * p0 - n0 * p2
            w[at.BY_ANCHOR[2] + lane] = n0 * p1 - n1 * p0
            w[at.BY_ANCHOR[3] + lane] = -f * n0
            w[at.BY_ANCHOR[4] + lane] = -f * n1
            w[at.BY_ANCHOR[5] + lane] = -f * n2
        w[at.POINT[0] + lane] = u0 + rho * c0
        w[at.POINT[1] + lane] = u1 + rho * c1
        w[at.POINT[2] + lane] = u2 + rho * c2
        w[at.RHO + lane], w[at.BY_TANGENTS[0] + lane], w[at.BY_TANGENTS[1] + lane] = rho, by_x, by_y
        w[at.TANGENT_X[0] + lane], w[at.TANGENT_X[1] + lane], w[at.TANGENT_X[2] + lane] = x0, x1, x2
        w[at.TANGENT_Y[0] + lane], w[at.TANGENT_Y[1] + lane], w[at.TANGENT_Y[2] + lane] = y0, y1, y2
        w[at.ON_PLANE + lane] = 1.0 if state.on_plane[i] else 0.0
        w[at.FREE + lane] = 0.0 if state.on_plane[i] or known.at_infinity else 1.0
        w[at.AHEAD + lane] = 0.0 if state.on_plane[i] and rho <= 0.0 else 1.0


@part
def _project(k: int, camera: Floats, layout: Layout, state: Unknowns, w: Floats, out: Floats) -> None:
    """Project the points of a block into view k, with its zoom where it has one."""
    R, t = state.R, state.t
    r00, r01, r02, t0 = R[k, 0, 0], R[k, 0, 1], R[k, 0, 2], t[k, 0]
    r10, r11, r12, t1 = R[k, 1, 0], R[k, 1, 1], R[k, 1, 2], t[k, 1]
    r20, r21, r22, t2 = R[k, 2, 0], R[k, 2, 1], R[k, 2, 2], t[k, 2]
    zooms = layout.field == ZOOM_TERMS
    scale, k1 = np.exp(state.lens[0] + (state.field[k, 0] if zooms else 0.0)), state.lens[1]
    if camera[0] > 1.0:
        for lane in range(LANES):
            x, y, z = w[at.POINT[0] + lane], w[at.POINT[1] + lane], w[at.POINT[2] + lane]
            rho = w[at.RHO + lane]
            sees, px, py, x0, x1, x2, y0, y1, y2, f0, f1 = project_point(
                camera, scale, k1, r00 * x + r01 * y + r02 * z + rho * t0, r10 * x + r11 * y + r12 * z + rho * t1,
                r20 * x + r21 * y + r22 * z + rho * t2,
            )  # fmt: skip
            out[at.SEES + lane] = w[at.AHEAD + lane] if sees else 0.0
            out[at.OFFSET[0] + lane], out[at.OFFSET[1] + lane] = px, py
            out[at.BY_K1[0] + lane], out[at.BY_K1[1] + lane] = f0, f1
            out[at.X_BY_POINT[0] + lane], out[at.X_BY_POINT[1] + lane], out[at.X_BY_POINT[2] + lane] = x0, x1, x2
            out[at.Y_BY_POINT[0] + lane], out[at.Y_BY_POINT[1] + lane], out[at.Y_BY_POINT[2] + lane] = y0, y1, y2
    else:
        largest2 = camera[10] * camera[10]
        cx, cy, q1, q2, p1, p2, q3 = camera[3], camera[4], camera[5] + k1, camera[6], camera[7], camera[8], camera[9]
        fx, fy = scale * camera[1], scale * camera[2]
        for lane in range(LANES):
            x, y, z = w[at.POINT[0] + lane], w[at.POINT[1] + lane], w[at.POINT[2] + lane]
            rho = w[at.RHO + lane]
            X, Y = r00 * x + r01 * y + r02 * z + rho * t0, r10 * x + r11 * y + r12 * z + rho * t1
            Z = r20 * x + r21 * y + r22 * z + rho * t2
            # Without branches, so that a processor does several lanes at once.
            inverse = 1.0 / (Z if Z > 0.0 else 1.0)
            x, y = X * inverse, Y * inverse
            r2 = x * x + y * y
            ahead = (w[at.AHEAD + lane] if r2 < largest2 else 0.0) if Z > 0.0 else 0.0
            x, y, r2 = x if ahead > 0.0 else 0.0, y if ahead > 0.0 else 0.0, r2 if ahead > 0.0 else 0.0
            u, v, uu, uv, vv = radial_and_tangential(q1, q2, p1, p2, q3, x, y, r2)
            out[at.SEES + lane] = ahead
            out[at.OFFSET[0] + lane], out[at.OFFSET[1] + lane] = fx * u + cx, fy * v + cy
            out[at.BY_K1[0] + lane], out[at.BY_K1[1] + lane] = fx * x * r2, fy * y * r2
            gx, gy = fx * inverse, fy * inverse
            out[at.X_BY_POINT[0] + lane], out[at.X_BY_POINT[1] + lane] = gx * uu, gx * uv
            out[at.X_BY_POINT[2] + lane] = -gx * (uu * x + uv * y)
            out[at.Y_BY_POINT[0] + lane], out[at.Y_BY_POINT[1] + lane] = gy * uv, gy * vv
            out[at.Y_BY_POINT[2] + lane] = -gy * (uv * x + vv * y)


@part
def _weigh(
    n: int, k: int, observed: Observed, known: Known, layout: Layout, state: Unknowns, w: Floats, out: Floats
) -> None:
    """Residuals of a block in view k in units of the noise, the roots of their weights, and the cost of each track.

    * ``n``: Row of the observations.
    """
    rows, field, lens, gate2 = observed.rows, state.field, state.lens, observed.gate2
    cx, cy, p0, p1 = known.camera[3], known.camera[4], lens[3], lens[4]
    readout_s, share = lens[2] - known.corrected_s, 1.0 / (TUKEY_GATES * gate2)
    if layout.field == ZOOM_TERMS:
        p0, p1 = p0 + field[k, 1], p1 + field[k, 2]
    for lane in range(LANES):
        x, y = out[at.OFFSET[0] + lane], out[at.OFFSET[1] + lane]
        out[at.BY_FOCAL[0] + lane], out[at.BY_FOCAL[1] + lane] = x - cx, y - cy
        out[at.OFFSET[0] + lane] = x + p0 + readout_s * rows[n, at.SWEEP[0] + lane] - rows[n, at.PIXEL[0] + lane]
        out[at.OFFSET[1] + lane] = y + p1 + readout_s * rows[n, at.SWEEP[1] + lane] - rows[n, at.PIXEL[1] + lane]
    for q in range(FIELD_TERMS // 2 if layout.field == FIELD_TERMS else 0):
        by_x, by_y, place = field[k, q], field[k, FIELD_TERMS // 2 + q], at.PLACES[q]
        for lane in range(LANES):
            out[at.OFFSET[0] + lane] += by_x * rows[n, place + lane]
            out[at.OFFSET[1] + lane] += by_y * rows[n, place + lane]
    for lane in range(LANES):
        x, y = out[at.OFFSET[0] + lane], out[at.OFFSET[1] + lane]
        w0, w1, w2 = rows[n, at.WHITEN[0] + lane], rows[n, at.WHITEN[1] + lane], rows[n, at.WHITEN[2] + lane]
        e0, e1 = w0 * x + w1 * y, w1 * x + w2 * y
        seen, sees = rows[n, at.SEEN + lane], out[at.SEES + lane]
        left = 1.0 - (e0 * e0 + e1 * e1) * share
        left = left if left > 0.0 else 0.0
        left = left * sees
        w[at.COST + lane] += seen * gate2 * (1.0 - left * left * left)
        out[at.ROOT_WEIGHT + lane] = left * seen
        out[at.RESIDUAL[0] + lane], out[at.RESIDUAL[1] + lane] = e0, e1


@part
def _differentiate(n: int, k: int, a: int, observed: Observed, layout: Layout, state: Unknowns, room: Room) -> None:
    """The columns of derivatives of a block in view k, and the equations of its tracks."""
    rows, w, p, c, R, t = observed.rows, room.tracks, room.projected, room.columns, state.R, state.t
    r00, r01, r02 = R[k, 0, 0], R[k, 0, 1], R[k, 0, 2]
    r10, r11, r12 = R[k, 1, 0], R[k, 1, 1], R[k, 1, 2]
    r20, r21, r22 = R[k, 2, 0], R[k, 2, 1], R[k, 2, 2]
    # From the centre of the view to that of the anchor.
    s0, s1, s2 = to_world(R, k, vector_of(t, k))
    a0, a1, a2 = to_world(R, a, vector_of(t, a))
    s0, s1, s2 = (s0 - a0, s1 - a1, s2 - a2) if k != a else (0.0, 0.0, 0.0)
    for lane in range(LANES):
        left = p[at.ROOT_WEIGHT + lane]
        w0, w1 = left * rows[n, at.WHITEN[0] + lane], left * rows[n, at.WHITEN[1] + lane]
        w2 = left * rows[n, at.WHITEN[2] + lane]
        c[at.OF_RESIDUALS + lane] = left * p[at.RESIDUAL[0] + lane]
        c[at.OF_RESIDUALS + LANES + lane] = left * p[at.RESIDUAL[1] + lane]
        x, y = p[at.BY_FOCAL[0] + lane], p[at.BY_FOCAL[1] + lane]
        c[at.OF_LENS[0] + lane], c[at.OF_LENS[0] + LANES + lane] = w0 * x + w1 * y, w1 * x + w2 * y
        x, y = p[at.BY_K1[0] + lane], p[at.BY_K1[1] + lane]
        c[at.OF_LENS[1] + lane], c[at.OF_LENS[1] + LANES + lane] = w0 * x + w1 * y, w1 * x + w2 * y
        x, y = rows[n, at.SWEEP[0] + lane], rows[n, at.SWEEP[1] + lane]
        c[at.OF_LENS[2] + lane], c[at.OF_LENS[2] + LANES + lane] = w0 * x + w1 * y, w1 * x + w2 * y
        c[at.OF_LENS[3] + lane], c[at.OF_LENS[3] + LANES + lane] = w0, w1
        c[at.OF_LENS[4] + lane], c[at.OF_LENS[4] + LANES + lane] = w1, w2
    for row in range(2):
        for lane in range(LANES):
            o, left = row * LANES + lane, p[at.ROOT_WEIGHT + lane]
            g0, g1 = left * rows[n, at.WHITEN[row] + lane], left * rows[n, at.WHITEN[row + 1] + lane]
            # By the point in the axes of the view, then in those of the world.
            x = g0 * p[at.X_BY_POINT[0] + lane] + g1 * p[at.Y_BY_POINT[0] + lane]
            y = g0 * p[at.X_BY_POINT[1] + lane] + g1 * p[at.Y_BY_POINT[1] + lane]
            z = g0 * p[at.X_BY_POINT[2] + lane] + g1 * p[at.Y_BY_POINT[2] + lane]
            x, y, z = r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z
            X, Y, Z = w[at.POINT[0] + lane], w[at.POINT[1] + lane], w[at.POINT[2] + lane]
            rho, by_rho = w[at.RHO + lane], x * s0 + y * s1 + z * s2
            # By the unknowns of the track.
            by_x = x * w[at.TANGENT_X[0] + lane] + y * w[at.TANGENT_X[1] + lane] + z * w[at.TANGENT_X[2] + lane]
            by_y = x * w[at.TANGENT_Y[0] + lane] + y * w[at.TANGENT_Y[1] + lane] + z * w[at.TANGENT_Y[2] + lane]
            c[at.OF_TRACK[0] + o] = by_x + by_rho * w[at.BY_TANGENTS[0] + lane]
            c[at.OF_TRACK[1] + o] = by_y + by_rho * w[at.BY_TANGENTS[1] + lane]
            c[at.OF_TRACK[2] + o] = by_rho * w[at.FREE + lane]
            # By the pose of the view, by that of the anchor, and by the plane.
            x, y, z, u, v, q = Y * z - Z * y, Z * x - X * z, X * y - Y * x, rho * x, rho * y, rho * z
            c[at.OF_VIEW[0] + o], c[at.OF_VIEW[1] + o], c[at.OF_VIEW[2] + o] = x, y, z
            c[at.OF_VIEW[3] + o], c[at.OF_VIEW[4] + o], c[at.OF_VIEW[5] + o] = u, v, q
            by_rho *= w[at.ON_PLANE + lane]
            c[at.OF_ANCHOR[0] + o] = by_rho * w[at.BY_ANCHOR[0] + lane] - x
            c[at.OF_ANCHOR[1] + o] = by_rho * w[at.BY_ANCHOR[1] + lane] - y
            c[at.OF_ANCHOR[2] + o] = by_rho * w[at.BY_ANCHOR[2] + lane] - z
            c[at.OF_ANCHOR[3] + o] = by_rho * w[at.BY_ANCHOR[3] + lane] - u
            c[at.OF_ANCHOR[4] + o] = by_rho * w[at.BY_ANCHOR[4] + lane] - v
            c[at.OF_ANCHOR[5] + o] = by_rho * w[at.BY_ANCHOR[5] + lane] - q
            c[at.OF_PLANE[0] + o] = by_rho * w[at.BY_PLANE[0] + lane]
            c[at.OF_PLANE[1] + o] = by_rho * w[at.BY_PLANE[1] + lane]
            c[at.OF_PLANE[2] + o] = by_rho * w[at.BY_PLANE[2] + lane]
    half = FIELD_TERMS // 2
    for q in range(FIELD_TERMS if layout.field == FIELD_TERMS else 0):
        place = at.PLACES[q % half]
        for row in range(2):
            of = at.WHITEN[row + q // half]
            for lane in range(LANES):
                column = p[at.ROOT_WEIGHT + lane] * rows[n, of + lane] * rows[n, place + lane]
                room.table[at.FIELD + q, row * LANES + lane] = column
    for lane in range(LANES):
        x0, x1 = c[at.OF_TRACK[0] + lane], c[at.OF_TRACK[0] + LANES + lane]
        y0, y1 = c[at.OF_TRACK[1] + lane], c[at.OF_TRACK[1] + LANES + lane]
        z0, z1 = c[at.OF_TRACK[2] + lane], c[at.OF_TRACK[2] + LANES + lane]
        e0, e1 = c[at.OF_RESIDUALS + lane], c[at.OF_RESIDUALS + LANES + lane]
        w[at.OWN[0] + lane] += x0 * x0 + x1 * x1
        w[at.OWN[1] + lane] += x0 * y0 + x1 * y1
        w[at.OWN[2] + lane] += x0 * z0 + x1 * z1
        w[at.OWN[3] + lane] += y0 * y0 + y1 * y1
        w[at.OWN[4] + lane] += y0 * z0 + y1 * z1
        w[at.OWN[5] + lane] += z0 * z0 + z1 * z1
        w[at.GRADIENT[0] + lane] += x0 * e0 + x1 * e1
        w[at.GRADIENT[1] + lane] += y0 * e0 + y1 * e1
        w[at.GRADIENT[2] + lane] += z0 * e0 + z1 * e1
        # The residual across the epipolar line is that along the derivative by rho, turned by a right angle.
        w[at.SLOPE + lane] += z0 * e1 - z1 * e0
        w[at.CURVATURE + lane] += z0 * z0 + z1 * z1


# -- priors: of the lens, of fields of correlated errors, of measured rotations ----------------------------------------


@part
def add_priors(known: Known, unknowns: Unknowns, layout: Layout, equations: Equations, fill: bool) -> float:
    """Cost of the distance of a state from what is expected; with ``fill`` it joins the equations."""
    cost, field = 0.0, unknowns.field
    for q in range(layout.lens):
        place = place_in_lens(layout, q)
        pull = unknowns.lens[place] - known.lens[place]
        cost += _pulled(layout.focal + q, pull, known, equations, fill)
    for k in range(len(field)):
        for q in range(layout.field):
            cost += _pulled(layout.block * k + q, field[k, q], known, equations, fill)
    for k in range(1, len(field)):
        if known.turned_weights[k] > 0.0:
            at, pull = layout.field + layout.block * (k - 1), turn_between(unknowns.R, known.turned, k)
            cost += _pulled(at, pull[0], known, equations, fill)
            cost += _pulled(at + 1, pull[1], known, equations, fill)
            cost += _pulled(at + 2, pull[2], known, equations, fill)
    return cost


@inlined
def place_in_lens(layout: Layout, q: int) -> int:
    """The place in :attr:`Unknowns.lens` of unknown q of the lens."""
    return q if q < 2 or layout.readout else q + 1


@inlined
def _pulled(column: int, pull: float, known: Known, equations: Equations, fill: bool) -> float:
    """The cost of an unknown that is off by ``pull`` from what is expected of it."""
    weight = known.weights[column]
    if fill:
        equations.gradient[column] += weight * pull
        equations.normal[column, column] += weight
    return float(weight * pull * pull)


@inlined
def turn_between(R: Floats, turned: Floats, k: int) -> Vector:
    """The rotation vector from a measured rotation to that of view k: the logarithm of ``R_k turned_k^T``."""
    x = to_view(R, k, (turned[k, 0, 0], turned[k, 0, 1], turned[k, 0, 2]))
    y = to_view(R, k, (turned[k, 1, 0], turned[k, 1, 1], turned[k, 1, 2]))
    z = to_view(R, k, (turned[k, 2, 0], turned[k, 2, 1], turned[k, 2, 2]))
    axis = (0.5 * (y[2] - z[1]), 0.5 * (z[0] - x[2]), 0.5 * (x[1] - y[0]))
    sine = np.sqrt(dot(axis, axis))
    angle = np.arctan2(sine, 0.5 * (x[0] + y[1] + z[2] - 1.0))
    factor = angle / sine if sine > 1e-12 else 1.0
    return factor * axis[0], factor * axis[1], factor * axis[2]
