"""Tables with depth variation, quest beside PoseLib: ``python -m tests.benchmarks.quest.tables --out DIR``.

A table is a slanted plane whose points stand out by up to 1 to 5 % of their distance. A cell has the AUC at 5, 10 and
20 degrees of the first pose, and of the best of the returned poses.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.benchmarks.options import positive, run_on_one_thread, save
from tests.benchmarks.quest.cells import auc_cell
from tests.benchmarks.quest.measures import area_under_recall
from tests.benchmarks.quest.robust_methods import METHODS, available
from tests.benchmarks.quest.robust_trials import Answer, evaluate, warm_up
from tests.benchmarks.quest.scenes import FOCAL_PX, TABLES, draw_scene
from tests.benchmarks.tables import markdown_table

_NOISE_PX, _THRESHOLD_PX, _OUTLIERS, _MATCHES = 0.7, 2.0, (0.2, 0.5), 150


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table, and write it to a file if a folder is given."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.quest.tables", allow_abbrev=False)
    parser.add_argument("--trials", type=positive, default=100, help="scenes a row (default 100)")
    parser.add_argument("--out", type=Path, help="folder for tables.md")
    options = parser.parse_args(argv)
    methods, _ = available(["quest", "PoseLib", "PoseLib min 100"])
    warm_up(methods)
    rows = []
    for name, kind in TABLES.items():
        for outliers in _OUTLIERS:
            answers: dict[str, list[Answer]] = {method: [] for method in methods}
            for seed in range(options.trials):
                rng = np.random.default_rng((43, seed))
                scene = draw_scene(kind, rng, matches=_MATCHES, outlier_share=outliers, noise_px=_NOISE_PX)
                for method in methods:
                    run = METHODS[method][1]
                    estimate = run(scene.bearings1, scene.bearings2, _THRESHOLD_PX / FOCAL_PX, seed)
                    answers[method].append(evaluate(method, estimate, scene.R, scene.t))
            cells = [auc_cell(answers[method]) for method in methods]
            kept = [answer.kept_error_deg for answer in answers["quest"]]
            cells.append(" / ".join(f"{100 * area_under_recall(kept, bound):.0f}" for bound in (5, 10, 20)))
            rows.append([name, f"{outliers:.0%}", *cells])
    title = f"{options.trials} scenes a row, {_MATCHES} matches, {_NOISE_PX} px: AUC at 5 / 10 / 20 deg, %.\n\n"
    save(
        options.out, "tables.md", title + markdown_table(["table", "outliers", *methods, "best of quest"], rows) + "\n"
    )


if __name__ == "__main__":
    run_on_one_thread()
    main()
