"""Reliability of the parallax statement: ``python -m tests.benchmarks.quest.parallax_calibration``.

Three measures of :func:`quest.parallax_statement`: how often it reports a translation of a rotation-only camera (the
stated error rate against the share of trials with a lower p value), how often it reports a true translation, and how
often the true |t|/depth lies within a +- 2b.

For a rotation-only camera the tested motion is the one that most favours a false alarm among those that a search finds:
directions through pairs of matches, scored by inliers, the best refined together with the rotation, its inliers
selected as the estimator does. For a moving camera the tested motion is refined from the true one, with the same
selection: the table measures the statement and not the search. A share of the matches is outliers.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quest.geometry.epipolar import depths_from_pose, sampson_error
from quest.geometry.quaternion import rotation_from_vector
from quest.geometry.refine import refine_pose, tangent_basis
from quest.robust import kernels
from quest.robust.rotation import refine_rotation
from quest.uncertainty.parallax import LEAST_SINE2, RATIO_MADS, ParallaxStatement, parallax_statement
from tests.benchmarks.options import positive, progress, run_on_one_thread, save
from tests.benchmarks.tables import markdown_table

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Half the field of view of 640x480 px at a focal length of 458 px.
_HALF_VIEW = np.array([0.7, 0.52])
_NOISE_RAD = 0.7 / 458
_ERROR_RATES = (0.1, 0.01, 0.001)
_RATIOS = (0.003, 0.01, 0.03, 0.1)
_SHAPES = ("box", "plane", "wall")


@dataclass(frozen=True)
class Scene:
    """A scene to draw: a box of depths 1 to 4, a tilted plane, or a wall at right angles to the axis.

    ``ratio`` is |t| divided by the median depth, ``outliers`` the share of outliers.
    """

    shape: str
    count: int
    ratio: float
    outliers: float = 0.0
    noise_rad: float = _NOISE_RAD


@dataclass(frozen=True, eq=False)
class Views:
    """Matches of two views and their true motion; |t| = 1, and ``ratios`` are the true |t|/depth in camera 1."""

    scene: Scene
    m: Floats
    n: Floats
    R: Floats
    t: Floats
    ratios: Floats
    correct: Bools


@dataclass(frozen=True, eq=False)
class Motion:
    """A fitted motion, its inliers, and the statement about it."""

    R: Floats
    t: Floats
    kept: Bools
    statement: ParallaxStatement


def draw_views(scene: Scene, rng: np.random.Generator) -> Views:
    """Draw two views: 4 degrees about a random axis, a random direction of translation, Gaussian noise in both."""
    xy = rng.uniform(-1, 1, (scene.count, 2)) * _HALF_VIEW
    if scene.shape == "box":
        z = rng.uniform(1, 4, scene.count)
    else:
        slope = rng.uniform(-0.7, 0.7, 2) if scene.shape == "plane" else np.zeros(2)
        z = 2 / np.maximum(1 + xy @ slope, 0.3)
    points = np.column_stack([xy * z[:, None], z])
    depths = np.linalg.norm(points, axis=1)
    R = rotation_from_vector(np.deg2rad(4) * _unit(rng.normal(size=3)))
    t = _unit(rng.normal(size=3))
    length = scene.ratio * float(np.median(depths))
    m, n = _unit(points), _unit(points @ R.T + length * t)
    wrong = int(scene.outliers * scene.count)
    n[:wrong] = _unit(np.column_stack([rng.uniform(-1, 1, (wrong, 2)) * _HALF_VIEW, np.ones(wrong)]))
    correct = np.arange(scene.count) >= wrong
    return Views(
        scene, _noisy(rng, m, scene.noise_rad), _noisy(rng, n, scene.noise_rad), R, t, length / depths, correct
    )


def fitted_motion(views: Views, rng: np.random.Generator, *, from_truth: bool = False) -> Motion:
    """Refine the most favourable motion (or the true one), select its inliers and make the statement."""
    threshold = 3 * views.scene.noise_rad
    R, t = (views.R, views.t) if from_truth else _search(views, rng, threshold)
    gate = threshold
    for _ in range(3):
        kept, residuals = _kept(views.m, views.n, R, t, gate, threshold)
        if kept.sum() < 6:
            break
        noise = float(np.sqrt(np.sum(residuals[kept] ** 2) / max(int(kept.sum()) - 5, 1)))
        gate = min(threshold, 3 * noise)
        R, t = refine_pose(R, t, views.m[kept], views.n[kept], gate)
    kept, _ = _kept(views.m, views.n, R, t, gate, threshold)
    # The number of chance inliers, as in the estimator: on shuffled matches.
    shuffles = (views.n[rng.permutation(len(kept))] for _ in range(3))
    chance = [int(_kept(views.m, n, R, t, gate, threshold)[0].sum()) for n in shuffles] if views.scene.outliers else [0]
    if kept.sum() < 6:
        kept[:6] = True
    statement = parallax_statement(
        R,
        t,
        views.m[kept],
        views.n[kept],
        chance_matches=float(np.mean(chance)),
        wrong_matches=int((~kept).sum()),
    )
    return Motion(R, t, kept, statement)


def true_ratio(views: Views, R: Floats, t: Floats, kept: Bools) -> float:
    """The true weighted mean of |t|/depth, over those matches in the mean of the statement that are no outliers."""
    sine2 = 1 - (views.n @ t) ** 2
    typical = kept.copy()
    kernels.mark_typical(views.m, views.n, R, t, RATIO_MADS, LEAST_SINE2, typical)
    taken = typical & views.correct
    return float(sine2[taken] @ views.ratios[taken] / sine2[taken].sum())


def _search(views: Views, rng: np.random.Generator, threshold: float) -> tuple[Floats, Floats]:
    R = np.eye(3)
    for scale in (0.2, 0.02, 4 * threshold, threshold, threshold / 2):
        R = refine_rotation(R, views.m, views.n, scale, iterations=6)
    normals = np.cross(views.m @ R.T, views.n)
    first, second = rng.integers(0, len(normals), (2, 200))
    directions = np.cross(normals[first], normals[second])
    directions = _unit(directions[np.linalg.norm(directions, axis=1) > 1e-12])
    candidates = np.concatenate([directions, -directions])
    kept, residuals = _kept(views.m, views.n, R, candidates, threshold, threshold)
    costs = np.where(kept, residuals**2, threshold**2).sum(axis=1)
    first_R = R
    refined: list[tuple[float, tuple[Floats, Floats]]] = []
    for k in np.argsort(costs, kind="stable")[:3]:
        R, t = first_R, candidates[k]
        for gate in (2 * threshold, threshold):
            near, _ = _kept(views.m, views.n, R, t, gate, threshold)
            if near.sum() >= 6:
                R, t = refine_pose(R, t, views.m[near], views.n[near], threshold / 2)
        kept, residuals = _kept(views.m, views.n, R, t, threshold, threshold)
        refined.append((float(np.sum(np.where(kept, residuals**2, threshold**2))), (R, t)))
    return min(refined, key=lambda pair: pair[0])[1]


def _kept(m: Floats, n: Floats, R: Floats, t: Floats, gate: float, threshold: float) -> tuple[Bools, Floats]:
    """Matches within the gate that are not behind a camera beyond doubt, and the residuals of all matches."""
    residuals = sampson_error(R, t, m, n)
    u, v = depths_from_pose(R, t, m, n)
    cosine = np.einsum("ij,ij->i", m @ R.T, n)
    behind = (1 - cosine**2 > 2 * threshold**2) & ((u < 0) | (v < 0))
    return (np.abs(residuals) < gate) & ~behind, residuals


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _noisy(rng: np.random.Generator, rays: Floats, noise_rad: float) -> Floats:
    shifts = noise_rad * rng.normal(size=(len(rays), 2))
    return _unit(rays + np.einsum("nij,nj->ni", tangent_basis(rays), shifts))


def false_alarms(trials: int, seed: int) -> Iterator[list[str]]:
    """Rows of the first table."""
    for count in (10, 30, 100, 300, 1000, 2000):
        for outliers in (0.0, 0.3):
            rng = np.random.default_rng([seed, count, int(100 * outliers)])
            runs = max(trials * 100 // max(count, 100), 20)
            scene = Scene("box", count, 0.0, outliers)
            p = np.array([fitted_motion(draw_views(scene, rng), rng).statement.p_value for _ in range(runs)])
            shares = [f"{np.mean(p < rate):.4f}" for rate in _ERROR_RATES]
            yield [str(count), f"{outliers:.0%}", str(runs), *shares, f"{p.min():.1g}"]


def power(trials: int, seed: int) -> Iterator[list[str]]:
    """Rows of the second table."""
    for shape in _SHAPES:
        for count in (30, 100, 300, 1000):
            runs = max(trials * 100 // max(count, 100) // 4, 20)
            cells = []
            for ratio in _RATIOS:
                rng = np.random.default_rng([seed, count, int(1e4 * ratio), _SHAPES.index(shape)])
                found = []
                for _ in range(runs):
                    views = draw_views(Scene(shape, count, ratio, 0.2), rng)
                    motion = fitted_motion(views, rng, from_truth=True)
                    a, b = motion.statement.ratio, motion.statement.ratio_sigma
                    error = abs(a - true_ratio(views, motion.R, motion.t, motion.kept))
                    found.append((motion.statement.observable(1e-3), error <= 2 * b, np.isfinite(b)))
                cells.append(" / ".join(f"{share:.2f}" for share in np.mean(found, axis=0)))
            yield [shape, str(count), str(runs), *cells]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the trials and print the tables; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.quest.parallax_calibration", allow_abbrev=False)
    parser.description = "Error rates, power and coverage of the statement on parallax."
    parser.add_argument("--trials", type=positive, default=1000, metavar="N", help="of 100 matches; fewer of more")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the scenes (default 0)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write parallax_calibration.md there")
    options = parser.parse_args(argv)
    first = markdown_table(
        ["matches", "wrong", "trials", *(f"p < {rate:g}" for rate in _ERROR_RATES), "smallest p"],
        list(progress(false_alarms(options.trials, options.seed), "row", 12)),
    )
    second = markdown_table(
        ["scene", "matches", "trials", *(f"ratio {ratio:g}" for ratio in _RATIOS)],
        list(progress(power(options.trials, options.seed), "row", 12)),
    )
    text = (
        "Cameras that only turn: share of trials whose p value lies under the stated error rate.\n\n"
        f"{first}\n\n"
        "Cameras that move by a ratio of the median depth, 20 % wrong matches, noise 0.7 px at a focal length of "
        "458 px: share of trials with p < 0.001 / with the true ratio within a +- 2b (b infinite "
        "included) / with finite b.\n\n"
        f"{second}\n"
    )
    save(options.out, "parallax_calibration.md", text)
    return 0


if __name__ == "__main__":
    run_on_one_thread()
    sys.exit(main())
