"""2,000 hard scenes, quest beside PoseLib at its better setting: ``python -m tests.benchmarks.quest.hard_scenes``.

The scenes are those of :mod:`tests.benchmarks.quest.scenes` with a translation, in turn: 40 to 70 % outliers, 100 to
500 matches, 0.3 to 1 px. A row has the share of scenes whose first pose is within 5 degrees, and of those with such a
pose among the first pose and one alternative; then the same over the scenes that refinement from the truth on the true
inliers solves. The two figures differ most on planes, where two poses explain both images.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.benchmarks.options import positive, run_on_one_thread, save
from tests.benchmarks.quest.cells import FOUND_DEG
from tests.benchmarks.quest.measures import accuracy
from tests.benchmarks.quest.robust_methods import METHODS, available
from tests.benchmarks.quest.robust_trials import Answer, evaluate, oracle_error_deg, warm_up
from tests.benchmarks.quest.scenes import FOCAL_PX, SCENES, draw_scene
from tests.benchmarks.tables import markdown_table

_KINDS = tuple(name for name in SCENES if name != "rotation")
_OUTLIERS, _MATCHES, _NOISES_PX, _THRESHOLD_PX = (0.4, 0.5, 0.6, 0.7), (100, 200, 300, 500), (0.3, 0.7, 1.0), 2.0


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table, and write it to a file if a folder is given."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.quest.hard_scenes", allow_abbrev=False)
    parser.add_argument("--scenes", type=positive, default=2000, help="in all (default 2000)")
    parser.add_argument("--out", type=Path, help="folder for hard_scenes.md")
    options = parser.parse_args(argv)
    methods, _ = available(["quest", "PoseLib", "PoseLib min 100"])
    warm_up(methods)
    answers: dict[str, list[Answer]] = {method: [] for method in methods}
    oracle = []
    for k in range(options.scenes):
        rng = np.random.default_rng((47, k))
        outliers, matches, noise_px = (rng.choice(values) for values in (_OUTLIERS, _MATCHES, _NOISES_PX))
        kind = SCENES[_KINDS[k % len(_KINDS)]]
        scene = draw_scene(kind, rng, matches=int(matches), outlier_share=float(outliers), noise_px=float(noise_px))
        oracle.append(oracle_error_deg(scene, noise_px / FOCAL_PX))
        for method in methods:
            estimate = METHODS[method][1](scene.bearings1, scene.bearings2, _THRESHOLD_PX / FOCAL_PX, k)
            answers[method].append(evaluate(method, estimate, scene.R, scene.t))
    solved = np.array(oracle) < FOUND_DEG
    rows = []
    for name, scenes in [("all", np.arange(options.scenes)), ("solved from the truth", np.flatnonzero(solved))] + [
        (kind, np.arange(k, options.scenes, len(_KINDS))) for k, kind in enumerate(_KINDS)
    ]:
        cells = []
        for method in methods:
            some = [answers[method][k] for k in scenes]
            first, kept = ([getattr(answer, field) for answer in some] for field in ("error_deg", "kept_error_deg"))
            cells.append(f"{100 * accuracy(first, FOUND_DEG):.1f} / {100 * accuracy(kept, FOUND_DEG):.1f}")
        rows.append([name, str(len(scenes)), f"{100 * np.mean(solved[scenes]):.1f}", *cells])
    times = [
        f"{np.median([a.time_ms for a in answers[m]]):.1f} / {np.mean([a.time_ms for a in answers[m]]):.1f}"
        for m in methods
    ]
    rows.append(["processor time, ms: median / mean", "", "", *times])
    title = f"Pose within {FOUND_DEG:g} degrees, %: first / first or one alternative.\n\n"
    header = ["scenes", "number", "from the truth", *methods]
    save(options.out, "hard_scenes.md", title + markdown_table(header, rows) + "\n")


if __name__ == "__main__":
    run_on_one_thread()
    main()
