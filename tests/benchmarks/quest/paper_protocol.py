"""The synthetic experiment of [F17]: ``python -m tests.benchmarks.quest.paper_protocol``.

A camera of 800 px and 640x480 sees points in a box of 2.4 x 1.8 x 3 at a distance of 3 to 6 (or on a plane);
the second camera is rotated by up to 30 degrees and moved by up to 1 along each axis; Gaussian noise is added
in both images. The error is the metric of [F17] with its absolute value restored, ``acos |q . q*| / pi`` in
[0, 1/2], of the candidate closest to the truth; that of the direction of the translation is ``acos (t . t*) / pi``.

"Closest to the truth" favours a solver with many candidates, and the identity alone has an error of .033. So the tables
also give the number of candidates, the error of the candidate that :mod:`quest.paper.selection` ranks first from the
sample alone, and how often refinement on all matches of the pair reaches the end of refinement from the truth. This
refinement starts from the candidate ranked first, or from the best of the first four.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import matrix_from_quaternion
from quest.paper.printed import quest6_printed, quest7_printed
from quest.paper.quest6 import quest6
from quest.paper.selection import select_candidates
from quest.paper.translation import translation_and_depths
from tests.benchmarks.options import program, progress, run_on_one_thread, show
from tests.benchmarks.quest.paper_problems import Problems, draw_problems, rotation_error
from tests.benchmarks.quest.reference import refine_pose
from tests.benchmarks.quest.solvers import SOLVERS
from tests.benchmarks.tables import markdown_table

Floats = NDArray[np.float64]
Solve = Callable[[Floats, Floats], Floats]

#: The levels of the paper's figures, by scene.
NOISES_PX = {"general": (0.0, 0.5, 1.0, 2.0, 5.0, 10.0), "coplanar": (0.0, 0.25, 0.5, 1.0, 2.0)}
# Noise levels of the tables with the measures that do not favour many candidates.
_FAIR_NOISES_PX = (0.5, 2.0)
# Number of points for the solvers, and number of further points for the refinement.
_SAMPLE, _WITNESSES = 8, 52
# Two refinements ended at the same optimum if rotation and direction differ by less than this: far more than the error
# of an optimizer, far less than the distance of two solutions.
_SAME_ROTATION_RAD, _SAME_DIRECTION_RAD = 1e-3, 1e-2
# All matches are inliers, so no robust kernel is needed: a kernel this wide (in rad) is least squares.
_LEAST_SQUARES = 10.0
# Solvers whose lines can be distinguished in the plot. Variants with nearly the same line are in the tables only.
_SHOWN = {
    "QuEst 6 printed": ("tab:blue", ":", "o"),
    "QuEst 7 printed": ("tab:orange", ":", "o"),
    "QuEst 5": ("tab:green", "-", "o"),
    "QuEst 6": ("tab:blue", "-", "o"),
    "QuEst 6 fast": ("tab:red", "-", "o"),
    "QuEst 7": ("tab:orange", "-", "o"),
    "QuEst N, 8 points": ("tab:purple", "-", "o"),
    "5-point": ("tab:brown", "--", "s"),
    "6-point": ("tab:pink", "--", "^"),
    "7-point": ("tab:gray", "--", "v"),
    "8-point": ("tab:olive", "--", "D"),
    "homography, 8 points": ("tab:cyan", "--", "P"),
}


@dataclass(frozen=True)
class Contestant:
    """A solver of batches: bearings (B, points, 3) twice, to quaternions (B, K, 4) padded with NaN."""

    name: str
    points: int
    solve: Solve


@dataclass(frozen=True)
class Cell:
    """The results of a solver on the problems of one scene and level."""

    #: closest, first: (B,) Rotation error of the candidate closest to the truth, and of the one ranked first.
    closest: Floats
    first: Floats
    #: direction, direction_of_first: (B,) Direction error of the translation of these two candidates.
    direction: Floats
    direction_of_first: Floats
    #: Mean number of candidates.
    candidates: float
    #: reached_by_first, reached_by_four: Share of problems from which refinement reaches the truth; NaN where it was
    #: not measured.
    reached_by_first: float = np.nan
    reached_by_four: float = np.nan


Cells = Mapping[tuple[str, float, str], Cell]


def contestants() -> list[Contestant]:
    """All solvers of the comparison and the printed forms, in the order of the tables."""
    chosen = [
        Contestant("QuEst 6 printed", 6, _one_by_one(quest6_printed)),
        Contestant("QuEst 7 printed", 7, _one_by_one(quest7_printed)),
        Contestant("QuEst 6, x alone", 6, lambda m, n: quest6(m, n, lambdas="x")),
    ]
    for solver in SOLVERS.values():
        chosen.append(Contestant(solver.name, solver.sample_size, solver.function))
        if solver.name in ("QuEst N", "homography"):
            chosen.append(Contestant(f"{solver.name}, 8 points", 8, solver.function))
    return chosen


def _one_by_one(solve: Solve) -> Solve:
    """Make a solver of batches from a solver of one sample."""

    def solve_all(m: Floats, n: Floats) -> Floats:
        found = [solve(*sample) for sample in zip(m, n, strict=True)]
        padded = np.full((len(found), max(1, *map(len, found)), 4), np.nan)
        for row, q in zip(padded, found, strict=True):
            row[: len(q)] = q
        return padded

    return solve_all


def measure(solve: Solve, problems: Problems, points: int, refined: int = 0) -> Cell:
    """Run a solver on the first points of problems, and refine from its candidates in the first ``refined`` ones."""
    m, n = problems.m[:, :points], problems.n[:, :points]
    q = solve(m, n)
    kept, t = select_candidates(q, m, n, keep=4)
    cosine = np.abs((q @ problems.q[..., None])[..., 0])
    nearest = q[np.arange(len(q)), np.argmax(np.where(np.isfinite(cosine), cosine, -1.0), axis=1)]
    t_nearest = np.array([translation_and_depths(*each)[0] for each in zip(nearest, m, n, strict=True)])
    reached = np.array([_reached(problems, b, kept[b], t[b]) for b in range(refined)]).reshape(-1, 2)
    return Cell(
        rotation_error(q, problems.q),
        rotation_error(kept[:, :1], problems.q),
        _direction_error(t_nearest, problems.t),
        _direction_error(t[:, 0], problems.t),
        float(np.isfinite(q[..., 0]).sum(axis=1).mean()),
        *(reached.mean(axis=0).tolist() if refined else ()),
    )


def _direction_error(t: Floats, truth: Floats) -> Floats:
    """``acos (t . t*) / pi`` (B,); 1/2, as for a random guess, without a translation."""
    sine = np.linalg.norm(np.cross(t, truth), axis=1)
    angle = np.arctan2(sine, np.einsum("ij,ij->i", t, truth)) / np.pi
    return np.where(np.isfinite(angle), angle, 0.5)


def _reached(problems: Problems, b: int, q: Floats, t: Floats) -> tuple[bool, bool]:
    """Whether refinement of problem b reaches the truth from the first candidate, and from any of them."""
    m, n, truth = problems.m[b], problems.n[b], problems.t[b] / np.linalg.norm(problems.t[b])

    def refined(start: Floats, direction: Floats) -> tuple[Floats, Floats]:
        return refine_pose(matrix_from_quaternion(start), direction, m, n, _LEAST_SQUARES, iterations=50)

    R_end, t_end = refined(problems.q[b], truth)
    for k in np.flatnonzero(np.isfinite(q[:, 0])).tolist():
        R, direction = refined(q[k], t[k])
        if np.linalg.norm(R - R_end) < _SAME_ROTATION_RAD and np.linalg.norm(direction - t_end) < _SAME_DIRECTION_RAD:
            return k == 0, True
    return False, False


def _closest(cells: Cells, scene: str, names: list[str]) -> str:
    rows, noises = [], NOISES_PX[scene]
    for name in names:
        exact, *noisy = (cells[scene, noise, name] for noise in noises)
        rotations = [f"{cell.closest.mean():.4f}" for cell in noisy]
        rows.append([name, f"{np.median(exact.closest):.0e}", *rotations, f"{noisy[-1].direction.mean():.3f}"])
    header = ["solver", "0 px (median)", *(f"{noise:g} px" for noise in noises[1:]), f"direction, {noises[-1]:g} px"]
    return markdown_table(header, rows)


def _fair(cells: Cells, scene: str, names: list[str]) -> str:
    rows = []
    for name in names:
        row = [name, f"{cells[scene, _FAIR_NOISES_PX[0], name].candidates:.1f}"]
        for noise in _FAIR_NOISES_PX:
            cell = cells[scene, noise, name]
            row.append(f"{cell.first.mean():.4f} ({np.median(cell.first):.4f})")
            row.append(f"{cell.direction_of_first.mean():.3f}")
            row.append(f"{cell.reached_by_first:.2f} / {cell.reached_by_four:.2f}")
        rows.append(row)
    header = ["solver", "candidates"]
    for noise in _FAIR_NOISES_PX:
        header += [f"{noise:g} px: first, mean (median)", "direction", "reached by first / four"]
    return markdown_table(header, rows)


def _times(solvers: list[Contestant], seed: int, batch: int) -> str:
    """Microseconds of processor time for a sample, in batches."""
    problems = draw_problems(np.random.default_rng(seed), batch, _SAMPLE, 0.5)
    times: dict[str, list[float]] = {solver.name: [] for solver in solvers}
    for _ in range(9):  # the solvers alternate, so that other load of the machine affects all of them
        for solver in solvers:
            start = time.process_time()
            solver.solve(problems.m[:, : solver.points], problems.n[:, : solver.points])
            times[solver.name].append(1e6 * (time.process_time() - start) / batch)
    return markdown_table(
        ["solver", f"us, batches of {batch}"], [[name, f"{np.median(found):.0f}"] for name, found in times.items()]
    )


def plot(cells: Cells, path: Path) -> None:
    """Draw the error over the noise, of the candidate closest to the truth and of the first ranked."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    figure, axes = plt.subplots(2, 2, figsize=(12, 9), sharex="col", sharey="row", layout="constrained")
    for column, (scene, levels) in zip(axes.T, NOISES_PX.items(), strict=True):
        noises = levels[1:]  # errors without noise (rounding, or a solver that fails) are in the tables
        for ax, field, title in zip(
            column, ("closest", "first"), ("closest to the truth", "ranked first"), strict=True
        ):
            for name, (colour, line, marker) in _SHOWN.items():
                means = [float(np.mean(getattr(cells[scene, noise, name], field))) for noise in noises]
                ax.plot(noises, means, line, marker=marker, ms=5, color=colour, label=name)
            ax.set_title(f"{scene}: candidate {title}")
            ax.set_yscale("log")
            ax.set_yticks([0.003, 0.01, 0.03, 0.1, 0.3])
            ax.yaxis.set_major_formatter(ScalarFormatter())
            ax.yaxis.set_minor_formatter(NullFormatter())
            ax.grid(alpha=0.3)
        column[-1].set_xlabel("noise (px)")
        column[-1].set_xscale("log")
        column[-1].set_xticks(noises, [f"{noise:g}" for noise in noises])
        column[-1].xaxis.set_minor_formatter(NullFormatter())
    for ax in axes[:, 0]:
        ax.set_ylabel("mean rotation error, acos|q.q*| / pi")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside right center", frameon=False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Print the tables; with a file, write them and the plot beside it."""
    parser = program("quest.paper_protocol", __doc__)
    parser.add_argument("--problems", type=int, default=200, metavar="N", help="of a level (default 200)")
    parser.add_argument("--refined", type=int, default=100, metavar="N", help="of them (default 100)")
    parser.add_argument("--seed", type=int, default=0, help="of the problems (default 0)")
    options = parser.parse_args()
    solvers = contestants()
    cells: dict[tuple[str, float, str], Cell] = {}
    todo = [(scene, noise) for scene, noises in NOISES_PX.items() for noise in noises]
    for scene, noise in progress(todo, "level"):
        rng, coplanar = np.random.default_rng(options.seed), scene == "coplanar"
        sampled = draw_problems(rng, options.problems, _SAMPLE, noise, coplanar=coplanar, witnesses=_WITNESSES)
        refined = min(options.refined, options.problems) if noise in _FAIR_NOISES_PX else 0
        for solver in solvers:
            cells[scene, noise, solver.name] = measure(solver.solve, sampled, solver.points, refined)
    names = [solver.name for solver in solvers]
    parts = [f"{options.problems} problems a level, errors acos|q.q*|/pi and acos(t.t*)/pi, seed {options.seed}."]
    for scene in NOISES_PX:
        parts += [f"## {scene}: mean error of the candidate closest to the truth", _closest(cells, scene, names)]
        parts += [f"## {scene}: the fair measures", _fair(cells, scene, names)]
    parts += ["## Time", _times(solvers, options.seed, min(64, options.problems))]
    show("\n\n".join(parts) + "\n", options.out)
    if options.out is not None:
        plot(cells, options.out.with_suffix(".png"))


if __name__ == "__main__":
    run_on_one_thread()
    main()
