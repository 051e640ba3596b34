"""The plots of the synthetic experiment of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tests.benchmarks.quest.paper_cells import NOISES_PX, Cell

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


def draw(cells: Mapping[tuple[str, float, str], Cell], out: Path) -> None:
    """Write paper_protocol.png: error over noise, of the candidate closest to the truth and of the first ranked."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    figure, axes = plt.subplots(2, 2, figsize=(12, 9), sharex="col", sharey="row", layout="constrained")
    for column, (scene, levels) in zip(axes.T, NOISES_PX.items(), strict=True):
        noises = levels[1:]  # errors without noise (rounding, or a solver that fails) are in the tables
        for ax, measure in zip(column, ("closest", "first"), strict=True):
            for name, (colour, line, marker) in _SHOWN.items():
                means = [float(np.mean(getattr(cells[scene, noise, name], measure))) for noise in noises]
                ax.plot(noises, means, line, marker=marker, ms=5, color=colour, label=name)
            ax.set_title(f"{scene}: candidate {'closest to the truth' if measure == 'closest' else 'ranked first'}")
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
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "paper_protocol.png", dpi=110)
    plt.close(figure)
