"""The paper's experiment on real images: ``python -m tests.benchmarks.paper_real_images [FOLDER...] --out FILE``.

The experiment follows the comparison on real images of [F17]. Each solver gets the best matches of each pair of frames,
as many as it needs at least, without RANSAC and without refinement. The program draws box plots of the errors of
rotation and translation for each solver and data set. The matches are SIFT matches (the paper uses SURF), ranked by the
distance of their descriptors. A FOLDER is a sequence of KITTI odometry, TUM RGB-D, ICL-NUIM or TrakMark, which are the
four data sets of [F17], or of another layout of ``docs/how-to/data-sets.md``. By default the program uses the
sequences below ``SLAM_INIT_DATA``.

The step between the frames of a pair is the smallest one at which the median parallax of the matches is one degree,
because the translation cannot be compared without parallax. ``--step`` sets the step instead.

Errors are angles divided by pi. The error of the rotation is the metric of [F17], with the absolute value that is
missing there: ``acos |q . q*| / pi`` in [0, 1/2]. The error of the translation is that of its direction:
``acos(t . t* / |t| |t*|) / pi`` in [0, 1]. A sample without any candidate counts 1/2. "Closest" is the measure of the
paper: the candidate that is nearest to the true rotation. It favours solvers with many candidates. "Ranked" is the
candidate that :func:`quest.paper.selection.select_candidates` puts first; this function uses only the sample. The
translation belongs to the rotation of the candidate in both cases, and cheirality gives its sign. Every candidate of a
5-point solver fits its five matches exactly, so that only cheirality ranks these candidates; 5-point solvers are meant
for RANSAC and not for this experiment. A single outlier among the best matches spoils a sample. "Clean" is the share of
samples whose matches all agree with the true pose within 2 px.

References
----------
.. [F17] K. Fathian et al., "Quaternion Based Camera Pose Estimation From Matched Feature Points", arXiv:1704.02672.
"""

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam_init.datasets import TimedSource, open_source
from tests.benchmarks.image_pairs import (
    DIRECTION_UNKNOWN,
    STATIC_SEQUENCE,
    ImagePair,
    find_sequences,
    sequence_pairs,
    true_matches,
)
from tests.benchmarks.options import data_folder, program, progress, run_on_one_thread, show
from tests.benchmarks.quest.paper_problems import Problems
from tests.benchmarks.quest.paper_protocol import Cell, measure
from tests.benchmarks.quest.solvers import SOLVERS, Solver
from tests.benchmarks.tables import markdown_table

_STEPS = (1, 2, 5, 10, 20, 30)
_PARALLAX_RAD = np.deg2rad(1.0)
_CLEAN_PX = 2.0
#: The fields of the errors of a cell, of the candidate closest to the truth and of the one ranked first.
_FIELDS = {"rotation": ("closest", "first"), "translation": ("direction", "direction_of_first")}
_MEASURES = ("closest", "ranked")


@dataclass(frozen=True, eq=False)
class DataSet:
    """Pairs of a sequence: name of the sequence, step between the frames of a pair, pairs."""

    name: str
    step: int
    pairs: list[ImagePair]


@dataclass(frozen=True, eq=False)
class Measured:
    """The errors of a solver on the pairs of a data set, and the share of the samples without an outlier."""

    cell: Cell
    clean: float


Results = Mapping[str, Mapping[str, Measured]]


def read_data_set(name: str, source: TimedSource, limit: int, step: int | None = None) -> DataSet:
    """Read pairs of a sequence; by default with the smallest step that gives a median parallax of one degree."""
    steps = [s for s in _STEPS if s < len(source)] or [1]
    if step is None:
        step = next((s for s in steps if _parallax(sequence_pairs(source, s, 3)) > _PARALLAX_RAD), steps[-1])
    return DataSet(name, step, list(sequence_pairs(source, step, limit)))


def _parallax(pairs: Iterable[ImagePair]) -> float:
    chords = (np.linalg.norm(p.bearings1 @ p.cam2_from_cam1.R.T - p.bearings2, axis=1) for p in pairs)
    medians = [2 * np.arcsin(0.5 * np.median(chord)) for chord in chords]
    return float(np.nanmedian(medians)) if medians else 0.0


def measure_best(solver: Solver, pairs: Sequence[ImagePair]) -> Measured | None:
    """Measure a solver on the best matches of each pair; None if no pair has enough matches."""
    size = solver.sample_size
    usable = [pair for pair in pairs if len(pair.bearings1) >= size]
    if not usable:
        return None
    best = [np.argsort(pair.distances, kind="stable")[:size] for pair in usable]
    m = np.array([pair.bearings1[rows] for pair, rows in zip(usable, best, strict=True)])
    n = np.array([pair.bearings2[rows] for pair, rows in zip(usable, best, strict=True)])
    q, t = (np.array([getattr(pair.cam2_from_cam1, name) for pair in usable]) for name in ("q_wxyz", "t"))
    clean = [
        true_matches(pair, *rays, _CLEAN_PX / pair.focal_px).all()
        for pair, rays in zip(usable, zip(m, n, strict=True), strict=True)
    ]
    return Measured(measure(solver.function, Problems(m, n, q, t), size), float(np.mean(clean)))


def _table(results: Results, sets: Sequence[DataSet], which: str) -> str:
    """Make the table of the quartiles of an error ("rotation" or "translation"), by data set and solver."""
    rows = []
    for data in sets:
        for solver, found in results[data.name].items():
            errors = [getattr(found.cell, field) for field in _FIELDS[which]]
            figures = [str(len(errors[0])), f"{100 * found.clean:.0f} %", f"{found.cell.candidates:.1f}"]
            quartiles = [" / ".join(f"{value:.4f}" for value in np.percentile(one, (25, 50, 75))) for one in errors]
            rows.append([f"{data.name}, step {data.step}", solver, *figures, *quartiles])
    header = ["data set", "solver", "pairs", "clean", "candidates", *(f"{name}: quartiles" for name in _MEASURES)]
    return markdown_table(header, rows)


def _summary(results: Results, which: str) -> str:
    """Make the table of the medians over all pairs of all data sets, by solver and measure."""
    rows = []
    for solver in dict.fromkeys(solver for errors in results.values() for solver in errors):
        cells = [errors[solver].cell for errors in results.values() if solver in errors]
        pooled = [np.concatenate([getattr(cell, field) for cell in cells]) for field in _FIELDS[which]]
        rows.append([solver, str(len(pooled[0])), *(f"{np.median(values):.4f}" for values in pooled)])
    return markdown_table([f"median error of {which}", "pairs", *_MEASURES], rows)


def plot(results: Results, sets: Sequence[DataSet], which: str, path: Path) -> None:
    """Draw box plots of an error ("rotation" or "translation"): a panel per data set, two boxes per solver."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.artist import Artist

    columns = min(3, len(sets))
    rows = -(-len(sets) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(5 * columns, 3.4 * rows), squeeze=False, sharey=True, layout="constrained"
    )
    for axis in axes.flat[len(sets) :]:
        axis.set_visible(False)
    handles: list[Artist] = []
    for axis, data in zip(axes.flat, sets, strict=False):
        solvers = list(results[data.name])
        handles = []
        for offset, colour, field in zip((-0.18, 0.18), ("#9ecae1", "#08519c"), _FIELDS[which], strict=True):
            values = [np.maximum(getattr(results[data.name][s].cell, field), 1e-5) for s in solvers]
            boxes = axis.boxplot(
                values, positions=np.arange(len(solvers)) + offset, widths=0.3, patch_artist=True, sym=".",
                medianprops={"color": "#fd8d3c", "linewidth": 1.5}, flierprops={"markersize": 3},
            )  # fmt: skip
            for box in boxes["boxes"]:
                box.set_facecolor(colour)
            handles.append(boxes["boxes"][0])
        axis.set_xticks(np.arange(len(solvers)), solvers, rotation=40, ha="right", fontsize=8)
        axis.set_yscale("log")
        axis.set_title(f"{data.name}, step {data.step}", fontsize=9)
        axis.grid(axis="y", alpha=0.3)
    for row in axes:
        row[0].set_ylabel(f"{which} error / pi")
    labels = ["closest to the truth", "ranked first"]
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> int:
    """Run the experiment; return the exit code."""
    parser = program("paper_real_images", __doc__)
    parser.add_argument("folders", nargs="*", metavar="FOLDER", help="sequences (default: all below SLAM_INIT_DATA)")
    parser.add_argument("--pairs", type=int, default=30, metavar="N", help="of each sequence (default 30)")
    parser.add_argument("--step", type=int, metavar="K", help="frames between the two of a pair")
    options = parser.parse_args()
    named = {folder: folder for folder in options.folders}
    if not named:
        data = data_folder()
        moving = [name for name in find_sequences(data) if name != STATIC_SEQUENCE]
        named = {name + " *" * name.startswith(DIRECTION_UNKNOWN): str(data / name) for name in moving}
    if not named:
        print(f"no sequence below {data_folder()}: name folders, or set SLAM_INIT_DATA", file=sys.stderr)
        return 2
    read, results = [], {}
    for name, folder in progress(named.items(), "set"):
        read.append(read_data_set(name, open_source(folder), options.pairs, options.step))
        found = {solver.name: measure_best(solver, read[-1].pairs) for solver in SOLVERS.values()}
        results[name] = {solver: measured for solver, measured in found.items() if measured is not None}
    sets = [data for data in read if results[data.name]]
    parts = []
    for which in _FIELDS:
        parts += [f"**{which.capitalize()} error / pi**", _summary(results, which), _table(results, sets, which)]
    parts.append("\\* the ground truth does not resolve the direction of so short a baseline.")
    show("\n\n".join(parts) + "\n", options.out)
    if options.out is not None:
        for which in _FIELDS:
            plot(results, sets, which, options.out.with_name(f"{options.out.stem}_{which}.png"))
    return 0


if __name__ == "__main__":
    run_on_one_thread()
    sys.exit(main())
