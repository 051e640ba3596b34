"""Joins two maps where they see the same place: a similarity of seven unknowns, with the risk that it is chance.

1. Points of both maps with similar descriptors are matched: mutual nearest neighbours that pass Lowe's ratio test.
2. Three matches give a similarity [U91]_. Of many draws those count that explain most matches. A match is explained
   where its point of either map lies near the rays of its point of the other map, so that no depth is compared: depths
   of a young map are known to some per cent, and directions to a pixel.
3. The best draws are refined on the rays, with the points held, and the best one with the points free. All poses are
   held. Leaving out one view after the other tells what their errors make of the scale [E82]_.
4. The number of similarities that explain as many matches by chance is bounded as in :mod:`quest.chance`: M matches
   have C(M, 3) samples, and shuffled matches tell how often a similarity explains a random one. A second similarity
   that explains half as many of the other matches makes the place ambiguous.

References
----------
.. [U91] S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991.
.. [E82] B. Efron, "The Jackknife, the Bootstrap and Other Resampling Plans", SIAM 1982.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from math import log

import numpy as np

from quest.chance import false_alarms, log_binomial, upper_share
from quest.geometry.quaternion import rotation_from_vector
from slam_init.errors import SlamInitError, check_type
from slam_init.frontend.sift import match_descriptors
from slam_init.mapping.places import RATIO
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.join import Join, NoJoin, Similarity
from slam_init.types.place import Place

#: A match is explained within this angle: five pixels at a focal length of 500 px. A point whose depth is off by a
#: tenth moves by that much for a camera that has moved sideways by a tenth of its distance.
#: Class: assumption.
_GATE_RAD = 0.01
#: Gates of the test of chance, as shares, and the wide gate by which random matches are counted. Class: definition.
_GATES, _WIDE = 0.5 ** np.arange(5.0), 8.0
#: Drawn samples: with one right match of eight, 2,000 draws hold four right samples. Draws that are refined.
#: Class: budget.
_DRAWS, _REFINED = 2000, 12
#: Gauss-Newton steps of a refinement: they start within a few gates. Class: budget.
_STEPS = 10
#: Expected number of chance similarities up to which maps are joined: of a thousand pairs of maps, one in ten is joined
#: falsely by chance alone. Class: level.
MAX_RISK = 1e-4
#: Another similarity with this share of the inliers is a rival. Class: assumption.
_RIVAL = 0.5
#: Largest relative deviation of the scale: with two of them the distance of a point is off by a tenth, which is as well
#: as a young map knows it. Class: level.
_MAX_SCALE_SIGMA = 0.05
#: Shifts of the matches that stand for random ones, and matches below which nothing can count. Class: budget.
_SHUFFLES, _LEAST = 20, 8


@dataclass(frozen=True, eq=False)
class _Side:
    """The matched points of a map, and the rays that see them, by match."""

    points: Floats
    #: (V, 3, 3) and (V, 3): cam_from_world.
    R: Floats
    t: Floats
    view: Ints
    match: Ints
    rays: Floats
    noise: float

    @staticmethod
    def of(place: Place, chosen: Ints) -> _Side:
        position = np.full(len(place.points), -1)
        position[chosen] = np.arange(len(chosen))
        match = position[place.observation_points]
        seen = match >= 0
        poses = [view.world_from_cam.inverse() for view in place.views]
        R, t = np.array([pose.R for pose in poses]), np.array([pose.t for pose in poses])
        view, rays = place.observation_views[seen], place.observation_bearings[seen]
        return _Side(place.points[chosen], R, t, view, match[seen], rays, place.noise_rad)

    def where(self, rows: Bools) -> _Side:
        """The rays of some rows."""
        return replace(self, view=self.view[rows], match=self.match[rows], rays=self.rays[rows])

    def of_matches(self, kept: Bools) -> _Side:
        """Only some of the matches, counted anew."""
        number = np.cumsum(kept) - 1
        few = self.where(kept[self.match])
        return replace(few, points=self.points[kept], match=number[few.match])

    def without_view(self, view: int) -> _Side:
        """The rays of all other views."""
        return self.where(np.asarray(self.view != view))

    def in_views(self, points: Floats) -> Floats:
        """Points (M, 3) in the camera of each ray."""
        return np.asarray(np.einsum("nij,nj->ni", self.R[self.view], points[self.match]) + self.t[self.view])

    def errors(self, points: Floats) -> Floats:
        """Root mean square angles (M,) between points and the rays of their matches."""
        X = self.in_views(points)
        X /= np.maximum(np.linalg.norm(X, axis=1, keepdims=True), 1e-12)
        count = np.maximum(np.bincount(self.match, minlength=len(points)), 1)
        squares = np.bincount(self.match, np.sum((X - self.rays) ** 2, axis=1), minlength=len(points))
        return np.asarray(np.sqrt(squares / count))


def join(first: Place, second: Place, seed: int = 0) -> Join:
    """Find the similarity between two maps that see the same place.

    Parameters
    ----------
    first, second : Place
        From :func:`slam_init.load_place`.
    seed : int
        Of the random draws.

    Returns
    -------
    Join
        Falsy with a reason where the maps are not joined.

    Raises
    ------
    SlamInitError
        If one is no place, or the seed is no number.
    """
    for place in (first, second):
        check_type(place, Place, "a place to join", "load_place(PATH)")
    check_type(seed, (int, np.integer), "the seed", "an integer from 0 on")
    if seed < 0:
        raise SlamInitError(f"the seed is {seed}: give an integer from 0 on")
    i, j = match_descriptors(first.descriptors, second.descriptors, RATIO)
    total = len(i)
    none = Join(None, NoJoin.NO_COMMON_PLACE, 1.0, math.inf, total, 0)
    if total < _LEAST:
        return none
    a, b = _Side.of(first, i), _Side.of(second, j)
    rng = np.random.default_rng(seed)
    best = _best(a, b, rng)
    if best is None:
        return none
    model, error = best
    inliers = np.asarray(error < _GATE_RAD)
    risk = min(1.0, _chance(a, b, model, error))
    failed = replace(none, risk=risk, inliers=int(inliers.sum()))
    if risk > MAX_RISK:
        return failed
    if _has_rival(a, b, inliers, rng):
        return replace(failed, reason=NoJoin.AMBIGUOUS_PLACE)
    model, sigma = _adjusted(a.of_matches(inliers), b.of_matches(inliers), model)
    # The unit of the points of a map is known in its baselines by errors that all its rays share.
    same_lens = first.lens == second.lens != ()
    sigma = math.hypot(sigma, first.unit_error.of_ratio(second.unit_error, same_lens=same_lens))
    if not sigma < _MAX_SCALE_SIGMA:
        return replace(failed, reason=NoJoin.SCALE_OPEN, scale_sigma=sigma)
    return Join(model.inverse(), None, risk, sigma, total, int(inliers.sum()))


def _errors(a: _Side, b: _Side, b_from_a: Similarity) -> Floats:
    """The larger of the two errors (M,) of each match: of its point of b in a, and of that of a in b."""
    return np.maximum(a.errors(b_from_a.inverse().apply(b.points)), b.errors(b_from_a.apply(a.points)))


def _best(a: _Side, b: _Side, rng: np.random.Generator) -> tuple[Similarity, Floats] | None:
    """The similarity b_from_a that explains most matches, with its errors."""
    s, R, t = _drawn(a.points, b.points, rng)
    usable = np.isfinite(s) & (s > 0)
    s, R, t = s[usable], R[usable], t[usable]
    if len(s) == 0:
        return None
    scores = np.zeros(len(s))
    moved = s[:, None, None] * np.einsum("hij,mj->hmi", R, a.points) + t[:, None]
    scores = _explained(b, moved)
    back = np.einsum("hij,hmi->hmj", R, b.points[None] - t[:, None]) / s[:, None, None]
    scores = np.sum(np.minimum(scores, _explained(a, back)), axis=1)
    found = None
    for k in np.argsort(-scores, kind="stable")[:_REFINED]:
        model = Similarity(float(s[k]), R[k], t[k])
        for gate in (4 * _GATE_RAD, 2 * _GATE_RAD, _GATE_RAD):
            near = _errors(a, b, model) < gate
            if near.sum() < _LEAST // 2:
                break
            model = _refined(a.of_matches(near), b.of_matches(near), model)
        error = _errors(a, b, model)
        score = float(np.sum(np.maximum(0.0, 1 - (error / _GATE_RAD) ** 2)))
        if found is None or score > found[0]:
            found = score, model, error
    return None if found is None else found[1:]


def _drawn(a: Floats, b: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Similarities b_from_a of samples of three matches: s (H,), R (H, 3, 3), t (H, 3)."""
    rows = np.argsort(rng.random((_DRAWS, len(a))), axis=1)[:, :3] if len(a) < 64 else _triples(len(a), rng)
    p, q = a[rows], b[rows]
    p_mean, q_mean = p.mean(axis=1, keepdims=True), q.mean(axis=1, keepdims=True)
    p, q = p - p_mean, q - q_mean
    u, d, vt = np.linalg.svd(np.einsum("hki,hkj->hij", q, p))
    sign = np.linalg.det(u) * np.linalg.det(vt)
    d[:, 2] *= sign
    u[:, :, 2] *= sign[:, None]
    R = u @ vt
    with np.errstate(divide="ignore", invalid="ignore"):
        # The ratio of the extents is symmetric in both maps.
        s = np.sqrt(np.sum(q**2, axis=(1, 2)) / np.sum(p**2, axis=(1, 2)))
    return s, R, q_mean[:, 0] - s[:, None] * np.einsum("hij,hj->hi", R, p_mean[:, 0])


def _triples(count: int, rng: np.random.Generator) -> Ints:
    """Samples of three, drawn with replacement; of 64 or more, one in 20 has a match twice, and fits nothing."""
    return rng.integers(0, count, (_DRAWS, 3))


def _explained(side: _Side, points: Floats) -> Floats:
    """How well points (H, M, 3) of each draw lie on a ray of their match: 1 on it, 0 beyond four gates."""
    _, row = np.unique(side.match, return_index=True)
    view = side.view[row]
    X = np.einsum("mij,hmj->hmi", side.R[view], points) + side.t[view]
    X /= np.maximum(np.linalg.norm(X, axis=2, keepdims=True), 1e-12)
    return np.asarray(np.maximum(0.0, 1 - np.sum((X - side.rays[row]) ** 2, axis=2) / (4 * _GATE_RAD) ** 2))


def _direction(X: Floats, rays: Floats) -> tuple[Floats, Floats]:
    """Residuals (N, 3) of directions, and their derivatives (N, 3, 3) by the points in the camera."""
    length = np.maximum(np.linalg.norm(X, axis=1, keepdims=True), 1e-12)
    unit = X / length
    return unit - rays, (np.eye(3) - unit[:, :, None] * unit[:, None, :]) / length[:, :, None]


def _generators(X: Floats) -> Floats:
    """Derivatives (N, 3, 7) of moved points by rotation, translation and the logarithm of the scale."""
    G = np.zeros((len(X), 3, 7))
    G[:, 0, 1], G[:, 0, 2], G[:, 1, 2] = X[:, 2], -X[:, 1], X[:, 0]
    G[:, 1, 0], G[:, 2, 0], G[:, 2, 1] = -X[:, 2], X[:, 1], -X[:, 0]
    G[:, :, 3:6] = np.eye(3)
    G[:, :, 6] = X
    return G


def _moved(model: Similarity, step: Floats) -> Similarity:
    R, scale = rotation_from_vector(step[:3]), math.exp(float(np.clip(step[6], -1, 1)))
    return Similarity(model.s * scale, R @ model.R, scale * R @ model.t + step[3:6])


def _refined(a: _Side, b: _Side, model: Similarity) -> Similarity:
    """Gauss-Newton on the rays of both maps, with all points held; Cauchy's loss at the gate."""
    for _ in range(_STEPS // 2):
        moved, back = model.apply(a.points), model.inverse().apply(b.points)
        r_b, D_b = _direction(b.in_views(moved), b.rays)
        J_b = D_b @ b.R[b.view] @ _generators(moved)[b.match]
        r_a, D_a = _direction(a.in_views(back), a.rays)
        J_a = -D_a @ a.R[a.view] @ (model.R.T / model.s) @ _generators(b.points)[a.match]
        r, J = np.concatenate([r_a, r_b]), np.concatenate([J_a, J_b])
        weight = 1 / (1 + np.sum(r**2, axis=1) / _GATE_RAD**2)
        A = np.einsum("n,nki,nkj->ij", weight, J, J)
        step = _solved(A, -np.einsum("n,nki,nk->i", weight, J, r))
        model = _moved(model, step)
    return model


def _solved(A: Floats, g: Floats) -> Floats:
    """The step of a normal equation whose open directions are held."""
    return np.asarray(np.linalg.lstsq(A, g, rcond=1e-12)[0])


def _adjusted(a: _Side, b: _Side, model: Similarity) -> tuple[Similarity, float]:
    """The similarity with free points, and the relative deviation of its scale."""
    model, points, sigma = _bundle(a, b, model, a.points, _STEPS)
    variance = sigma**2
    for side, other in ((a, b), (b, a)):
        views = np.unique(side.view)
        if len(views) < 2:
            continue
        logs = []
        for view in views:
            few = side.without_view(int(view))
            sides = (few, other) if side is a else (other, few)
            logs.append(log(_bundle(*sides, model, points, 3)[0].s))
        variance += (len(logs) - 1) * float(np.var(logs))
    return model, math.sqrt(variance)


def _bundle(a: _Side, b: _Side, model: Similarity, points: Floats, steps: int) -> tuple[Similarity, Floats, float]:
    """Gauss-Newton over the similarity and the points in the frame of a, whose unknowns are eliminated.

    * Returns: The similarity, the points, and the deviation of the logarithm of the scale by the noise.
    """
    sigma = math.inf
    for _ in range(steps):
        moved = model.apply(points)
        r_a, D_a = _direction(a.in_views(points), a.rays)
        P_a = D_a @ a.R[a.view]
        r_b, D_b = _direction(b.in_views(moved), b.rays)
        at_b = D_b @ b.R[b.view]
        P_b, S_b = at_b @ (model.s * model.R), at_b @ _generators(moved)[b.match]
        w_a = 1 / (a.noise**2 * (1 + np.sum(r_a**2, axis=1) / (3 * a.noise) ** 2))
        w_b = 1 / (b.noise**2 * (1 + np.sum(r_b**2, axis=1) / (3 * b.noise) ** 2))
        count = len(points)
        H, g, C = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros((count, 3, 7))
        for side, P, r, w in ((a, P_a, r_a, w_a), (b, P_b, r_b, w_b)):
            np.add.at(H, side.match, np.einsum("n,nki,nkj->nij", w, P, P))
            np.add.at(g, side.match, np.einsum("n,nki,nk->ni", w, P, r))
        np.add.at(C, b.match, np.einsum("n,nki,nkj->nij", w_b, P_b, S_b))
        H += 1e-9 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        inverse = np.linalg.pinv(H, hermitian=True)
        A = np.einsum("n,nki,nkj->ij", w_b, S_b, S_b) - np.einsum("mki,mkl,mlj->ij", C, inverse, C)
        h = np.einsum("n,nki,nk->i", w_b, S_b, r_b) - np.einsum("mki,mkl,ml->i", C, inverse, g)
        step = _solved(A, -h)
        points = points - np.einsum("mij,mj->mi", inverse, g + C @ step)
        model = _moved(model, step)
        sigma = math.sqrt(max(float(np.linalg.pinv(A, hermitian=True)[6, 6]), 0.0))
    return model, points, sigma


def _chance(a: _Side, b: _Side, model: Similarity, error: Floats) -> float:
    """Expected number of similarities that explain as many random matches."""
    total, wide = len(error), 0
    back, moved = model.inverse().apply(b.points), model.apply(a.points)
    shuffles = range(1, min(total, _SHUFFLES + 1))
    for shift in shuffles:
        one, other = a.errors(np.roll(back, shift, axis=0)), b.errors(np.roll(moved, -shift, axis=0))
        # The point of b that is shuffled to a match of a is at the same row of b.
        wide += int(np.count_nonzero(np.maximum(one, np.roll(other, shift)) < _WIDE * _GATE_RAD))
    # A random point lies in a gate as often as its area says.
    share = np.asarray(upper_share(wide, len(shuffles) * total) * (_GATES / _WIDE) ** 2)
    counts = np.array([np.count_nonzero(error < _GATE_RAD * gate) for gate in _GATES])
    return false_alarms(counts, total, 3, log(len(_GATES)) + log_binomial(total, 3), share)


def _has_rival(a: _Side, b: _Side, inliers: Bools, rng: np.random.Generator) -> bool:
    """Whether another similarity explains half as many of the other matches, and more than chance."""
    others = ~inliers
    if others.sum() < max(_LEAST, _RIVAL * inliers.sum()):
        return False
    a, b = a.of_matches(others), b.of_matches(others)
    best = _best(a, b, rng)
    if best is None or np.count_nonzero(best[1] < _GATE_RAD) < _RIVAL * inliers.sum():
        return False
    return _chance(a, b, *best) < MAX_RISK
