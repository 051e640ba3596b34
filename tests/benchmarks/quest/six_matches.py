"""Six matches against five in the robust search: ``python -m tests.benchmarks.quest.six_matches --out DIR``.

Four tables:

* **Samples**: six matches of a scene, without outliers. Without noise a solver finds a sample where one of its poses is
  the true one. Under noise the measure is the optimum next to the truth: the pose to which refinement on the sample
  takes the true pose. A solver finds it where refinement of one of its poses ends there.
* **Time of a sample**: processor time in microseconds, the median over blocks of samples. "Solved" is the call of the
  solver. "Solved and scored" is the loop of the search, all solutions compared on all matches.
* **Yield**: the share of the samples without outliers from which refinement on all matches leads to the motion.
* **Search**: :func:`quest.estimate_relative_pose` with both solvers on the same matches, with the same bound on the
  error and the same confidence.

"Five" is Newton's method from two starts for each sample, as in the search: the identity and the rotation that explains
most matches by itself (in the first table: that fits the sample best). The other solvers are QuEst 6: compiled
(:mod:`quest.robust.kernels.six_point`), and in numpy with the best four candidates of each sample.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import matrix_from_quaternion, quaternion_from_matrix, rotation_from_vector
from quest.geometry.refine import refine_pose
from quest.robust import kernels
from quest.robust.kernels import six_point
from quest.robust.pose_problem import PoseProblem
from quest.robust.rotation import fit_rotation, refine_rotation
from quest.robust.samples import draw_samples
from quest.solvers.quest6 import quest6
from quest.solvers.quest6_fast import quest6_fast
from quest.solvers.selection import select_candidates
from slam_init.output.tables import markdown_table
from tests.benchmarks.quest.measures import accuracy, pose_errors_deg
from tests.benchmarks.quest.running import positive, run_on_one_thread, save
from tests.benchmarks.quest.scenes import FOCAL_PX, SCENES, Scene, draw_scene

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Pose = tuple[Floats, Floats]
#: ``solve(m, n, rng)``: the poses of six matches.
Solve = Callable[[Floats, Floats, np.random.Generator], Sequence[Pose]]

#: Noise and threshold of the tables of samples and yields, as in the robust comparison.
_NOISE_PX, _THRESHOLD_PX, _YIELD_NOISE_PX = 0.5, 2.0, 0.7
#: Distance of two poses (radians, rotation plus direction) below which they are one: without noise, and after
#: refinement.
_EXACT, _SAME = 1e-6, 1e-3
#: Number of samples in a block of the measured times, and of blocks.
_BLOCK, _BLOCKS = 200, 15
_SEARCHED = ("general .15", "general .03", "plane .15", "nadir climbing .15", "desk .15", "forward .15")


class Sample(NamedTuple):
    """Six matches, the true pose, and the noise that they have."""

    m: Floats
    n: Floats
    R: Floats
    t: Floats


class _Kind(NamedTuple):
    """Scenes of samples: largest and smallest rotation, baseline in units of the depth, and whether on a plane."""

    least_deg: float
    most_deg: float
    baseline: float
    planar: bool


#: Name -> kind of scene. Rotations beyond 30 degrees are those of a camera that sees all rays.
SAMPLES = {
    "general": _Kind(0, 30, 0.2, False),
    "plane": _Kind(0, 30, 0.2, True),
    "baseline 0.03": _Kind(0, 30, 0.03, False),
    "90 to 180 deg": _Kind(90, 180, 0.2, False),
    "180 deg": _Kind(180, 180, 0.2, False),
    "plane, 180 deg": _Kind(180, 180, 0.2, True),
}


def draw_sample(kind: str, rng: np.random.Generator, noise_px: float) -> Sample:
    """Draw six points at depths of 3 to 8, seen by two cameras; the noise is that of a focal length of 458 px."""
    scene = SAMPLES[kind]
    X = rng.uniform([-2, -1.5, 3], [2, 1.5, 8], (6, 3))
    if scene.planar:
        slopes = rng.uniform(-0.6, 0.6, 2)
        X[:, 2] = 5 + X[:, :2] @ slopes
    axis, t = _unit(rng.normal(size=3)), _unit(rng.normal(size=3))
    R = rotation_from_vector(np.radians(rng.uniform(scene.least_deg, scene.most_deg)) * axis)
    sigma = noise_px / FOCAL_PX
    m, n = (_unit(_unit(Y) + sigma * rng.normal(size=Y.shape)) for Y in (X, X @ R.T + 5 * scene.baseline * t))
    return Sample(m, n, R, t)


def poses_by_six(m: Floats, n: Floats, rng: np.random.Generator) -> list[Pose]:
    """The poses of the compiled solver, which draws nothing."""
    R, t = np.empty((six_point.MOST_POSES, 3, 3)), np.empty((six_point.MOST_POSES, 3))
    count = six_point.solve_six(m, n, np.arange(6), _THRESHOLD_PX / FOCAL_PX, six_point.STEPS, R, t)
    return [(R[k], t[k]) for k in range(count)]


def _poses_by_five(m: Floats, n: Floats, rng: np.random.Generator) -> list[Pose]:
    """The poses of five of the six matches."""
    found = []
    for start in (np.eye(3), refine_rotation(np.eye(3), m, n, 1.0)):
        R, t = start.copy(), _unit(rng.normal(size=3))
        if kernels.newton_five(m, n, np.arange(5), R, t):
            found.append((R, t))
    return found


def _poses_by_numpy(solver: Callable[[Floats, Floats], Floats]) -> Solve:
    """A solver of QuEst with the best four of its candidates."""

    def solve(m: Floats, n: Floats, rng: np.random.Generator) -> list[Pose]:
        q, t = select_candidates(solver(m[None], n[None]), m[None], n[None])
        known = np.isfinite(q[0, :, 0])
        return list(zip(matrix_from_quaternion(q[0, known]), t[0, known], strict=True))

    return solve


_SOLVERS: dict[str, Solve] = {
    "QuEst 6 compiled": poses_by_six,
    "QuEst 6 fast, numpy": _poses_by_numpy(quest6_fast),
    "QuEst 6, numpy": _poses_by_numpy(quest6),
    "five, two starts": _poses_by_five,
}


def _unit(rays: Floats) -> Floats:
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _distance(pose: Pose, other: Pose) -> float:
    chord = np.linalg.norm(pose[0] - other[0]) / np.sqrt(2)  # the angle, where it is small
    return float(chord + np.linalg.norm(pose[1] - other[1]))


def _refined(pose: Pose, m: Floats, n: Floats) -> Pose:
    R, t = np.array(pose[0], order="C"), np.array(pose[1])
    kernels.refine(m, n, np.ones(len(m), bool), R, t, 1.0, 50)
    return R, t


def _samples_table(problems: int, seed: int) -> str:
    rows = []
    for kind in SAMPLES:
        for noise_px in (0.0, _NOISE_PX):
            rng = np.random.default_rng(seed)
            samples = [draw_sample(kind, rng, noise_px) for _ in range(problems)]
            optima = [(s.R, s.t) if noise_px == 0 else _refined((s.R, s.t), s.m, s.n) for s in samples]
            for name, solve in _SOLVERS.items():
                rows.append([kind, f"{noise_px:g}", name, *_sample_cells(samples, optima, solve, noise_px)])
    header = ["scene", "noise (px)", "solver", "found, %", "missed", "median error of the nearest", "poses"]
    return markdown_table(header, rows)


def _sample_cells(samples: Sequence[Sample], optima: Sequence[Pose], solve: Solve, noise_px: float) -> list[str]:
    rng, found, errors, count = np.random.default_rng(0), 0, [], 0
    for sample, optimum in zip(samples, optima, strict=True):
        poses = solve(sample.m, sample.n, rng)
        count += len(poses)
        errors.append(min((_distance(pose, (sample.R, sample.t)) for pose in poses), default=np.inf))
        if noise_px == 0:
            found += errors[-1] < _EXACT
        else:
            found += any(_distance(_refined(pose, sample.m, sample.n), optimum) < _SAME for pose in poses)
    median, total = float(np.median(errors)), len(samples)
    error = f"{median:.0e} rad" if noise_px == 0 else f"{np.degrees(median):.1f} deg"
    return [f"{100 * found / total:.1f}", str(total - found), error, f"{count / total:.2f}"]


def _scene(name: str, outliers: float, rng: np.random.Generator, noise_px: float, matches: int) -> Scene:
    return draw_scene(SCENES[name], rng, matches=matches, outlier_share=outliers, noise_px=noise_px)


def _times_table(seed: int) -> str:
    rows = []
    threshold_rad = _THRESHOLD_PX / FOCAL_PX
    for name in ("general .15", "plane .15"):
        for outliers in (0.0, 0.2, 0.5, 0.7):
            rng = np.random.default_rng(seed)
            scene = _scene(name, outliers, rng, _YIELD_NOISE_PX, 500)
            m, n = scene.bearings1, scene.bearings2
            rotations = np.stack([np.eye(3), fit_rotation(m, n, threshold_rad, rng)[0]])
            times: dict[str, list[float]] = {}
            for _ in range(_BLOCKS + 1):  # the first block compiles
                samples = draw_samples(rng, len(m), 6, _BLOCK)
                directions = _unit(rng.normal(size=(_BLOCK, 2, 3)))
                for title, run in _timed(m, n, samples, rotations, directions, threshold_rad).items():
                    begin = time.process_time()
                    run()
                    times.setdefault(title, []).append(1e6 * (time.process_time() - begin) / _BLOCK)
            rows.append([name, f"{100 * outliers:.0f} %", *(f"{np.median(each[1:]):.1f}" for each in times.values())])
    header = ["scene", "outliers", *times]
    return markdown_table(header, rows)


def _timed(
    m: Floats, n: Floats, samples: Ints, rotations: Floats, directions: Floats, threshold_rad: float
) -> dict[str, Callable[[], None]]:
    """What the table of times measures, each on all samples of a block."""
    found_R, found_t = np.empty((six_point.MOST_POSES, 3, 3)), np.empty((six_point.MOST_POSES, 3))

    def pool() -> tuple[Floats, Floats, Floats, Ints, Floats]:
        return np.zeros((8, 3, 3)), np.zeros((8, 3)), np.full(8, np.inf), np.zeros(8, np.int64), np.zeros(2)

    def six() -> None:
        for rows in samples:
            six_point.solve_six(m, n, rows, threshold_rad, six_point.STEPS, found_R, found_t)

    def six_scored() -> None:
        six_point.try_samples_of_six(m, n, samples, threshold_rad, six_point.STEPS, *pool())

    def five() -> None:
        five_rows = np.ascontiguousarray(samples[:, :5])
        for rows, starts in zip(five_rows, directions, strict=True):
            for R, t in zip(rotations, starts, strict=True):
                kernels.newton_five(m, n, rows, R.copy(), t.copy())

    def five_scored() -> None:
        kernels.try_samples(m, n, np.ascontiguousarray(samples[:, :5]), rotations, directions, threshold_rad, *pool())

    def fast() -> None:
        select_candidates(quest6_fast(m[samples], n[samples]), m[samples], n[samples])

    return {
        "six: solved": six,
        "solved and scored": six_scored,
        "five: solved": five,
        "solved and scored ": five_scored,
        "QuEst 6 fast, numpy: solved": fast,
    }


def _yield_table(samples: int, seed: int) -> str:
    rows = []
    for name in SCENES:
        if name == "rotation":
            continue
        led: dict[str, list[bool]] = {"six": [], "five": []}
        for scene_seed in range(4):
            rng = np.random.default_rng([seed, scene_seed])
            scene = _scene(name, 0.0, rng, _YIELD_NOISE_PX, 300)
            m, n = scene.bearings1, scene.bearings2
            problem = PoseProblem(m, n, _THRESHOLD_PX / FOCAL_PX)
            optimum = refine_pose(scene.R, scene.t, m, n, problem.threshold_rad)
            rotation = fit_rotation(m, n, problem.threshold_rad, rng)[0]
            for rows_of_sample in draw_samples(rng, len(m), 6, samples):
                a, b = m[rows_of_sample], n[rows_of_sample]
                by_five = []
                for start in (np.eye(3), rotation):
                    R, t = start.copy(), _unit(rng.normal(size=3))
                    if kernels.newton_five(a, b, np.arange(5), R, t):
                        by_five.append((R, t))
                led["six"].append(_leads(problem, poses_by_six(a, b, rng), optimum))
                led["five"].append(_leads(problem, by_five, optimum))
        rows.append([name, *(f"{np.mean(led[solver]):.2f}" for solver in ("six", "five"))])
    return markdown_table(["scene", "six", "five, two starts"], rows)


def _leads(problem: PoseProblem, poses: Sequence[Pose], optimum: Pose) -> bool:
    """Whether refinement of the best of the poses ends within 2 degrees of the optimum."""
    if not poses:
        return False
    models = np.array([np.concatenate([quaternion_from_matrix(R), t]) for R, t in poses])
    best = models[np.argmin(problem.costs(models)[0])]
    near = problem.explained(best, 2 * problem.threshold_rad)
    best = problem.refine(best, near, 0.5 * problem.threshold_rad) if near.sum() >= 6 else best
    return max(pose_errors_deg(matrix_from_quaternion(best[:4]), best[4:], *optimum)) < 2


def _search_table(trials: int, matches: int, seed: int) -> str:
    from quest.estimate import RelativePose, estimate_relative_pose

    rows = []
    for name in _SEARCHED:
        for outliers in (0.2, 0.5, 0.7):
            answers: dict[str, list[tuple[int, float, float, float]]] = {"five": [], "quest6": []}
            for k in range(trials):
                scene = _scene(name, outliers, np.random.default_rng([seed, k]), _YIELD_NOISE_PX, matches)
                for solver, results in answers.items():
                    begin = time.process_time()
                    pose = estimate_relative_pose(
                        scene.bearings1, scene.bearings2, threshold_rad=_THRESHOLD_PX / FOCAL_PX, seed=k, solver=solver
                    )
                    elapsed = 1e3 * (time.process_time() - begin)
                    found: list[Pose] = []
                    if isinstance(pose, RelativePose):
                        found = [(pose.R, pose.t), *((other.R, other.t) for other in pose.alternatives)]
                    errors = [max(pose_errors_deg(R, t, scene.R, scene.t)) for R, t in found] or [np.inf]
                    results.append((pose.evidence.samples or 0, elapsed, errors[0], min(errors)))
            row = [name, f"{100 * outliers:.0f} %"]
            for results in answers.values():
                samples, times, first, kept = zip(*results, strict=True)
                within = f"{100 * accuracy(first, 5.0):.0f} / {100 * accuracy(kept, 5.0):.0f}"
                row += [f"{np.median(samples):.0f}", f"{np.median(times):.1f}", within]
            rows.append(row)
    header = ["scene", "outliers"]
    for solver in ("five", "six"):
        header += [f"{solver}: samples", "ms", "first / returned within 5 deg, %"]
    return markdown_table(header, rows)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the tables, and write them to a file if a folder is given."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.quest.six_matches", allow_abbrev=False)
    parser.add_argument("--problems", type=positive, default=500, help="samples a row (default 500)")
    parser.add_argument("--trials", type=positive, default=20, help="searches a row (default 20)")
    parser.add_argument("--matches", type=positive, default=500, help="of a search (default 500)")
    parser.add_argument("--seed", type=int, default=0, help="of the scenes (default 0)")
    parser.add_argument("--out", type=Path, help="folder for six_matches.md")
    options = parser.parse_args(argv)
    # The first searches compile.
    _search_table(1, 100, options.seed)
    problems, trials, matches, seed = options.problems, options.trials, options.matches, options.seed
    parts = [
        f"{problems} samples and {trials} searches a row, seed {seed}; times are processor time.",
        f"## Samples\n\n{_samples_table(problems, seed)}",
        f"## Time of a sample, us (500 matches)\n\n{_times_table(seed)}",
        f"## Yield, share of samples at {_YIELD_NOISE_PX} px\n\n{_yield_table(problems // 8 + 1, seed)}",
        f"## Search, {matches} matches, {_YIELD_NOISE_PX} px\n\n{_search_table(trials, matches, seed)}",
    ]
    save(options.out, "six_matches.md", "\n\n".join(parts) + "\n")


if __name__ == "__main__":
    run_on_one_thread()
    main()
