"""The paper's experiment on real images: ``python -m tests.benchmarks.paper_real_images [FOLDER...] --out DIR``.

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

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quest.geometry.epipolar import parallax_angles
from quest.paper.selection import select_candidates
from slam_init.datasets import TimedSource, open_source
from slam_init.types.arrays import Floats
from tests.benchmarks.image_pairs import (
    DIRECTION_UNKNOWN,
    STATIC_SEQUENCE,
    ImagePair,
    find_sequences,
    sequence_pairs,
    true_matches,
)
from tests.benchmarks.options import data_folder, positive, progress, run_on_one_thread, save
from tests.benchmarks.quest.paper_problems import rotation_error
from tests.benchmarks.quest.solvers import SOLVERS
from tests.benchmarks.tables import markdown_table

_STEPS = (1, 2, 5, 10, 20, 30)
_PARALLAX_RAD = np.deg2rad(1.0)
#: The two measures of the errors, in the order of the tables and plots.
_MEASURES = ("closest", "ranked")
_CLEAN_PX = 2.0

Solve = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True, eq=False)
class DataSet:
    """Pairs of a sequence: name of the sequence, step between the frames of a pair, pairs."""

    name: str
    step: int
    pairs: list[ImagePair]


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of a solver on the pairs of a data set, in units of pi, by measure ("closest", "ranked")."""

    #: rotation, translation: (P,)
    rotation: dict[str, Floats]
    translation: dict[str, Floats]
    #: Share of the samples without an outlier.
    clean: float
    #: Mean number of candidates.
    candidates: float


def read_data_set(name: str, source: TimedSource, limit: int, step: int | None = None) -> DataSet:
    """Read pairs of a sequence; by default with the smallest step that gives a median parallax of one degree."""
    steps = [s for s in _STEPS if s < len(source)] or [1]
    if step is None:
        step = next((s for s in steps if _parallax(sequence_pairs(source, s, 3)) > _PARALLAX_RAD), steps[-1])
    return DataSet(name, step, list(sequence_pairs(source, step, limit)))


def _parallax(pairs: Iterable[ImagePair]) -> float:
    medians = [np.median(parallax_angles(p.cam2_from_cam1.R, p.bearings1, p.bearings2)) for p in pairs]
    return float(np.nanmedian(medians)) if medians else 0.0


def sample_of_best(pair: ImagePair, size: int) -> tuple[Floats, Floats] | None:
    """Return the ``size`` matches with the smallest descriptor distances; None if there are fewer matches."""
    if len(pair.bearings1) < size:
        return None
    best = np.argsort(pair.distances, kind="stable")[:size]
    return pair.bearings1[best], pair.bearings2[best]


def measure(solve: Solve, size: int, pairs: Sequence[ImagePair]) -> Errors | None:
    """Compute the errors of a solver on the best matches of each pair; None if no pair has enough matches."""
    usable = [(pair, sample) for pair in pairs if (sample := sample_of_best(pair, size)) is not None]
    if not usable:
        return None
    m, n = (np.array([sample[view] for _, sample in usable]) for view in (0, 1))
    q_true = np.array([pair.cam2_from_cam1.q_wxyz for pair, _ in usable])
    t_true = np.array([pair.cam2_from_cam1.t for pair, _ in usable])
    q = solve(m, n)
    cosine = np.where(np.isfinite(q[..., 0]), np.abs((q @ q_true[..., None])[..., 0]), -1.0)
    closest = np.take_along_axis(q, np.argmax(cosine, axis=1)[:, None, None], axis=1)
    rotation, translation = {}, {}
    for name, candidates in zip(_MEASURES, (closest, q), strict=True):
        chosen, t = select_candidates(candidates, m, n, keep=1)
        rotation[name] = rotation_error(chosen, q_true)
        translation[name] = _direction_error(t[:, 0], t_true)
    clean = [true_matches(pair, *sample, _CLEAN_PX / pair.focal_px).all() for pair, sample in usable]
    return Errors(rotation, translation, float(np.mean(clean)), float(np.isfinite(q[..., 0]).sum(axis=1).mean()))


def _direction_error(t: Floats, t_true: Floats) -> Floats:
    """Return the angles over pi (P,) between translations (P, 3); 1/2, as for a random guess, if one is missing."""
    sine = np.linalg.norm(np.cross(t, t_true), axis=1)
    angle = np.arctan2(sine, np.einsum("ij,ij->i", t, t_true)) / np.pi
    return np.where(np.isfinite(angle), angle, 0.5)


# -- tables and plots -----------------------------------------------------------------------------


def _table(results: dict[str, dict[str, Errors]], sets: Sequence[DataSet], which: str) -> str:
    """Make the table of the quartiles of an error ("rotation" or "translation"), by data set and solver."""
    rows = []
    for data in sets:
        for solver, errors in results[data.name].items():
            by_measure: dict[str, Floats] = getattr(errors, which)
            quartiles = [np.percentile(by_measure[name], (25, 50, 75)) for name in _MEASURES]
            rows.append(
                [
                    f"{data.name}, step {data.step}",
                    solver,
                    str(len(by_measure[_MEASURES[0]])),
                    f"{100 * errors.clean:.0f} %",
                    f"{errors.candidates:.1f}",
                    *(" / ".join(f"{value:.4f}" for value in values) for values in quartiles),
                ]
            )
    header = ["data set", "solver", "pairs", "clean", "candidates", *(f"{name}: quartiles" for name in _MEASURES)]
    return markdown_table(header, rows)


def _summary(results: dict[str, dict[str, Errors]], which: str) -> str:
    """Make the table of the medians over all pairs of all data sets, by solver and measure."""
    solvers = list(dict.fromkeys(solver for errors in results.values() for solver in errors))
    rows = []
    for solver in solvers:
        found = [errors[solver] for errors in results.values() if solver in errors]
        pooled = [np.concatenate([getattr(errors, which)[name] for errors in found]) for name in _MEASURES]
        rows.append([solver, str(len(pooled[0])), *(f"{np.median(values):.4f}" for values in pooled)])
    return markdown_table([f"median error of {which}", "pairs", *_MEASURES], rows)


def plot(
    results: dict[str, dict[str, Errors]], sets: Sequence[DataSet], which: str, path: str | os.PathLike[str]
) -> None:
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
        for offset, colour, name in zip((-0.18, 0.18), ("#9ecae1", "#08519c"), _MEASURES, strict=True):
            values = [np.maximum(getattr(results[data.name][s], which)[name], 1e-5) for s in solvers]
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
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the experiment; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.paper_real_images", allow_abbrev=False)
    parser.description = "Box plots of the solvers' errors on the best matches of real image pairs, without RANSAC."
    parser.add_argument("folders", nargs="*", metavar="FOLDER", help="sequences (default: all below SLAM_INIT_DATA)")
    parser.add_argument("--pairs", type=positive, default=30, metavar="N", help="of each sequence (default 30)")
    parser.add_argument("--step", type=positive, metavar="K", help="frames between the two of a pair")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write the tables and plots there")
    options = parser.parse_args(argv)
    named = {folder: folder for folder in options.folders}
    if not named:
        data = data_folder()
        moving = [name for name in find_sequences(data) if name != STATIC_SEQUENCE]
        named = {name + " *" * name.startswith(DIRECTION_UNKNOWN): str(data / name) for name in moving}
    if not named:
        print(f"no sequence below {data_folder()}: name folders, or set SLAM_INIT_DATA", file=sys.stderr)
        return 2
    read = [
        read_data_set(name, open_source(folder), options.pairs, options.step)
        for name, folder in progress(named.items(), "set")
    ]
    results = {data.name: _measure_all(data) for data in read}
    sets = [data for data in read if results[data.name]]
    parts = []
    for which in ("rotation", "translation"):
        parts += [f"**{which.capitalize()} error / pi**", _summary(results, which), _table(results, sets, which)]
        if options.out is not None:
            plot(results, sets, which, options.out / f"paper_real_images_{which}.png")
    parts.append("\\* the ground truth does not resolve the direction of so short a baseline.")
    save(options.out, "paper_real_images.md", "\n\n".join(parts) + "\n")
    return 0


def _measure_all(data: DataSet) -> dict[str, Errors]:
    results = {}
    for solver in SOLVERS.values():
        errors = measure(solver.function, solver.sample_size, data.pairs)
        if errors is not None:
            results[solver.name] = errors
    return results


if __name__ == "__main__":
    run_on_one_thread()
    sys.exit(main())
