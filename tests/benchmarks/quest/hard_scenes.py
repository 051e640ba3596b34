"""2,000 hard scenes, quest beside PoseLib at its better setting: ``python -m tests.benchmarks.quest.hard_scenes``.

The scenes are those of :mod:`tests.benchmarks.quest.scenes` with a translation, in turn: 40 to 70 % outliers, 100 to
500 matches, 0.3 to 1 px. A row has the share of scenes whose first pose is within 5 degrees, and of those with such a
pose among the first pose and one alternative; then the same over the scenes that refinement from the truth on the true
inliers solves. The two figures differ most on planes, where two poses explain both images.
"""

import numpy as np

from tests.benchmarks.options import program, run_on_one_thread, show
from tests.benchmarks.quest.reference import refine_pose
from tests.benchmarks.quest.robust_methods import (
    FOUND_DEG,
    METHODS,
    THRESHOLD_PX,
    Answer,
    answer,
    pose_errors_deg,
    share_below,
    warm_up,
)
from tests.benchmarks.quest.scenes import FOCAL_PX, SCENES, Scene, draw_scene
from tests.benchmarks.tables import markdown_table

_KINDS = tuple(name for name in SCENES if name != "rotation")
_OUTLIERS, _MATCHES, _NOISES_PX = (0.4, 0.5, 0.6, 0.7), (100, 200, 300, 500), (0.3, 0.7, 1.0)


def _error_from_truth_deg(scene: Scene, noise_rad: float) -> float:
    """Error of a refinement from the true pose on the true inliers."""
    m, n = scene.bearings1[scene.inliers], scene.bearings2[scene.inliers]
    # With Gaussian noise a kernel of three deviations is nearly least squares.
    return max(pose_errors_deg(*refine_pose(scene.R, scene.t, m, n, 3 * noise_rad), scene.R, scene.t))


def main() -> None:
    """Print the table, and write it to a file if one is given."""
    parser = program("quest.hard_scenes", __doc__)
    parser.add_argument("--scenes", type=int, default=2000, metavar="N", help="in all (default 2000)")
    options = parser.parse_args()
    warm_up(list(METHODS))
    answers: dict[str, list[Answer]] = {method: [] for method in METHODS}
    from_truth = []
    for k in range(options.scenes):
        rng = np.random.default_rng((47, k))
        outliers, matches, noise_px = (rng.choice(values) for values in (_OUTLIERS, _MATCHES, _NOISES_PX))
        kind = SCENES[_KINDS[k % len(_KINDS)]]
        scene = draw_scene(kind, rng, matches=int(matches), outlier_share=float(outliers), noise_px=float(noise_px))
        from_truth.append(_error_from_truth_deg(scene, noise_px / FOCAL_PX))
        for name, method in METHODS.items():
            estimate = method(scene.bearings1, scene.bearings2, THRESHOLD_PX / FOCAL_PX, k)
            answers[name].append(answer(estimate, scene.R, scene.t))
    solved = np.array(from_truth) < FOUND_DEG
    groups = {"all": np.arange(options.scenes), "solved from the truth": np.flatnonzero(solved)}
    groups |= {kind: np.arange(k, options.scenes, len(_KINDS)) for k, kind in enumerate(_KINDS)}
    rows = []
    for name, scenes in groups.items():
        cells = []
        for found in answers.values():
            first, kept = ([getattr(found[k], field) for k in scenes] for field in ("error_deg", "kept_error_deg"))
            cells.append(f"{share_below(first):.1f} / {share_below(kept):.1f}")
        rows.append([name, str(len(scenes)), f"{100 * np.mean(solved[scenes]):.1f}", *cells])
    times = [[one.time_ms for one in found] for found in answers.values()]
    of_methods = [f"{np.median(some):.1f} / {np.mean(some):.1f}" for some in times]
    rows.append(["processor time, ms: median / mean", "", "", *of_methods])
    title = f"Pose within {FOUND_DEG:g} degrees, %: first / first or one alternative.\n\n"
    show(title + markdown_table(["scenes", "number", "from the truth", *METHODS], rows) + "\n", options.out)


if __name__ == "__main__":
    run_on_one_thread()
    main()
