"""Bundle adjustment by pycolmap, with which that of slam_init is compared."""

from dataclasses import replace

import numpy as np
import pytest

from slam_init.compare.sources import open_compared
from slam_init.types.pose import Pose
from tests.benchmarks.map_quality import adjusted_by_pycolmap, errors_of
from tests.benchmarks.study_oracle import true_problem


def perturbed(problem):
    """The problem with a start that is wrong by up to 5 %."""
    rng = np.random.default_rng(0)
    first, *others = problem.world_from_cam
    return replace(
        problem,
        world_from_cam=(first, *(Pose(pose.R, pose.t * rng.uniform(0.95, 1.05, 3)) for pose in others)),
        points=problem.points * rng.uniform(0.95, 1.05, (len(problem.points), 1)),
    )


@pytest.mark.parametrize("robust", [False, True])
def test_pycolmap_finds_the_truth_from_a_perturbed_start(robust):
    pytest.importorskip("pycolmap")
    source = open_compared("points:room?noise_px=0&outliers=0&seed=4")
    start = perturbed(true_problem(source))
    if robust:  # every seventh landmark has an outlier in the third view
        outlier = (start.views == 2) & (start.landmarks % 7 == 0)
        start = replace(start, pixels=np.where(outlier[:, None], start.pixels + np.array([40.0, -25.0]), start.pixels))
    found = adjusted_by_pycolmap(source.camera, start, robust=robust)
    before, after = (errors_of(source, problem, found.track_ids) for problem in (start, found))
    assert before.direction_deg > 0.5
    assert before.depth > 0.01
    assert after.rotation_deg < 1e-4
    assert after.direction_deg < 1e-2
    assert after.depth < 1e-4
