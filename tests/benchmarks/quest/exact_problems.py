"""Solvers on problems without noise: ``python -m tests.benchmarks.quest.exact_problems --out DIR``.

Of each kind the same number of problems: points in a box, points on a plane, half turns, motion without a turn, along
the optical axis, turns without a motion, and baselines of 1e-4 of the depth. The other rotations are uniform on the
sphere. A problem is solved where a candidate is within 1e-6 rad of the true
rotation; a cell has the share that is solved, and the median and the largest error.

A second table has the paper's noise figures with its rotations: uniform on the sphere, noise in steps of .1 px at a
focal length of 800 px. A camera that is turned by any angle does not see the points of the other one, so that the noise
is added to the rays, orthogonally, and no image bounds them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import matrix_from_quaternion
from tests.benchmarks.options import positive, run_on_one_thread, save
from tests.benchmarks.quest.contestants import contestants
from tests.benchmarks.quest.paper_problems import rotation_error
from tests.benchmarks.quest.solvers import SOLVERS
from tests.benchmarks.tables import markdown_table

Floats = NDArray[np.float64]

_KINDS = ("general", "plane", "half turn", "no turn", "forward", "no motion", "baseline 1e-4")
#: Baselines where it is not 1; the mean depth is 4.5.
_BASELINES = {"no motion": 0.0, "baseline 1e-4": 4.5e-4}
_SOLVED_RAD, _BATCH, _FOCAL_PX = 1e-6, 500, 800.0


def draw(kind: str, rng: np.random.Generator, count: int, points: int) -> tuple[Floats, Floats, Floats]:
    """Bearings (B, N, 3) of two views, and the true rotations (B, 4) wxyz."""
    q = rng.normal(size=(count, 4))
    if kind == "half turn":
        q[:, 0] = 0
    elif kind == "no turn":
        q[:, 1:] = 0
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    X = rng.uniform([-1.2, -0.9, 3], [1.2, 0.9, 6], (count, points, 3))
    if kind == "plane":
        slope = rng.uniform(-1, 1, (count, 1, 2))
        X[..., 2] = 4.5 + np.sum(slope * X[..., :2], axis=2)
    t = rng.normal(size=(count, 1, 3))
    if kind == "forward":
        t[:] = (0.0, 0.0, 1.0)
    t *= _BASELINES.get(kind, 1.0) / np.linalg.norm(t, axis=2, keepdims=True)
    R = np.array([matrix_from_quaternion(one) for one in q])
    Y = X @ R.swapaxes(1, 2) + t
    return (*(view / np.linalg.norm(view, axis=2, keepdims=True) for view in (X, Y)), q)


def errors_rad(function: Callable[..., Floats], m: Floats, n: Floats, q: Floats) -> Floats:
    """Angle between the true rotation and the nearest candidate; infinite without one."""
    found = function(m, n)
    # The chord of the quaternions: the arc cosine would lose half of the digits.
    chord = np.minimum(*(np.linalg.norm(found - sign * q[:, None], axis=2) for sign in (1, -1)))
    return np.asarray(2 * np.nanmin(np.where(np.isnan(chord), np.inf, chord), axis=1))


def noise_table(kind: str, problems: int) -> str:
    """Mean error of the paper's metric of the candidate closest to the truth, over the noise in steps of .1 px."""
    chosen, rows = contestants(), []
    for noise_px in np.arange(0, 1.01, 0.1):
        cells = []
        for contestant in chosen:
            rng = np.random.default_rng(35)
            m, n, q = draw(kind, rng, problems, contestant.points)
            m, n = (rays + noise_px / _FOCAL_PX * rng.normal(size=rays.shape) for rays in (m, n))
            cells.append(f"{rotation_error(contestant.solve(m, n), q).mean():.4f}")
        rows.append([f"{noise_px:.1f}", *cells])
    return markdown_table(["px", *(contestant.name for contestant in chosen)], rows)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table, and write it to a file if a folder is given."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.quest.exact_problems", allow_abbrev=False)
    parser.add_argument("--problems", type=positive, default=20_000, help="of a kind (default 20000)")
    parser.add_argument("--noisy", type=positive, default=200, help="of a level of noise (default 200)")
    parser.add_argument("--out", type=Path, help="folder for exact_problems.md")
    options = parser.parse_args(argv)
    rows = []
    for solver in SOLVERS.values():
        cells = []
        for kind in _KINDS:
            rng, errors = np.random.default_rng(34), []
            for start in range(0, options.problems, _BATCH):
                m, n, q = draw(kind, rng, min(_BATCH, options.problems - start), solver.sample_size)
                errors.append(errors_rad(solver.function, m, n, q))
            each = np.concatenate(errors)
            solved = 100 * np.mean(each <= _SOLVED_RAD)
            cells.append(f"{solved:.2f} % / {np.median(each):.0e} / {each.max():.0e}")
        rows.append([solver.name, str(solver.sample_size), "yes" if solver.handles_planes else "no", *cells])
    title = f"{options.problems} problems a cell: solved to {_SOLVED_RAD:g} rad / median error / largest error.\n\n"
    header = ["solver", "matches", "claims planes", *_KINDS]
    parts = [title + markdown_table(header, rows)]
    for kind in ("general", "plane"):
        parts.append(f"{kind}, rotations uniform on the sphere: mean of acos |q . q*| / pi, {options.noisy} problems.")
        parts.append(noise_table(kind, options.noisy))
    save(options.out, "exact_problems.md", "\n\n".join(parts) + "\n")


if __name__ == "__main__":
    run_on_one_thread()
    main()
