"""The robust comparison: the properties of its scenes, and its measures on hand-computed cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quest.geometry.epipolar import depths_from_pose, sampson_error
from quest.geometry.quaternion import rotation_from_vector
from tests.benchmarks.quest import robust_comparison
from tests.benchmarks.quest.measures import area_under_recall, pose_errors_deg
from tests.benchmarks.quest.robust_methods import METHODS, Estimate, available
from tests.benchmarks.quest.robust_trials import Cell, full_grid, judge, oracle_error_deg, run_trials, star_grid
from tests.benchmarks.quest.scenes import FOCAL_PX, SCENES, draw_scene


def draw(name, seed=0, matches=120, outlier_share=0.0, noise_px=0.0):
    rng = np.random.default_rng(seed)
    return draw_scene(SCENES[name], rng, matches=matches, outlier_share=outlier_share, noise_px=noise_px)


@pytest.mark.parametrize("name", SCENES)
@settings(max_examples=10)
@given(seed=st.integers(0, 10_000))
def test_without_noise_the_truth_explains_all_inliers_in_front_of_both_cameras(name, seed):
    scene = draw(name, seed, outlier_share=0.25)
    assert (scene.inliers.sum(), len(scene.inliers)) == (90, 120)
    m, n = scene.bearings1[scene.inliers], scene.bearings2[scene.inliers]
    if name == "rotation":
        assert not scene.t.any()
        np.testing.assert_allclose(m @ scene.R.T, n, atol=1e-12)
        return
    assert np.linalg.norm(scene.t) == pytest.approx(1)
    assert np.abs(sampson_error(scene.R, scene.t, m, n)).max() < 1e-12
    u, v = depths_from_pose(scene.R, scene.t, m, n)
    assert min(u.min(), v.min()) > 0
    np.testing.assert_allclose(u[:, None] * m, scene.points[scene.inliers], rtol=1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_exactly_the_marked_points_lie_on_one_plane(name):
    scene = draw(name, matches=400)
    share = scene.on_plane.mean()
    if name.startswith(("general", "forward", "low", "rotation")):
        assert share == 0
        return
    plane = np.linalg.lstsq(scene.points[scene.on_plane], np.ones(scene.on_plane.sum()), rcond=None)[0]
    off = np.abs(scene.points @ plane - 1)
    assert off[scene.on_plane].max() < 1e-9
    if name.startswith("desk"):
        assert off[~scene.on_plane].min() > 0.02
    else:
        assert share == 1


def test_a_desk_has_60_to_90_percent_of_its_points_on_the_plane():
    shares = [draw("desk .15", seed, matches=400).on_plane.mean() for seed in range(30)]
    assert 0.55 < min(shares) < max(shares) < 0.95  # the requested share, and its fluctuation


def test_the_nadir_scenes_have_the_stated_climb():
    for seed in range(10):
        for name, low, high in (("nadir level .15", 0, 1e-9), ("nadir climbing .15", 15, 60)):
            scene = draw(name, seed)
            centre = -scene.R.T @ scene.t
            assert low - 1e-9 <= np.rad2deg(abs(np.arcsin(centre[2]))) <= high + 1e-9


def test_the_noise_has_the_requested_deviation():
    scene = draw("general .15", matches=4000, noise_px=0.7)
    residual_px = FOCAL_PX * sampson_error(scene.R, scene.t, scene.bearings1, scene.bearings2)
    # The angle of a pixel falls with the distance from the axis: at 35 degrees by up to a third.
    assert 0.45 < residual_px.std() < 0.72


def test_the_same_seed_draws_the_same_scene_and_another_seed_does_not():
    assert np.array_equal(draw("desk .15", 3).bearings2, draw("desk .15", 3).bearings2)
    assert not np.array_equal(draw("desk .15", 3).bearings2, draw("desk .15", 4).bearings2)


def test_errors_are_angles_and_include_the_sign_of_the_translation():
    R, t = np.eye(3), np.array([0.0, 0.0, 2.0])
    turned = rotation_from_vector(np.deg2rad([0.0, 3.0, 0.0]))
    assert pose_errors_deg(turned, np.array([0.0, 1.0, 1.0]), R, t) == pytest.approx((3, 45))
    assert pose_errors_deg(R, -t, R, t)[1] == pytest.approx(180)
    assert pose_errors_deg(R, np.zeros(3), R, t) == (0, np.inf)


def test_the_area_under_recall_equals_a_hand_computed_case():
    # Recall rises 0 -> 1/4 over [0, 1], 1/4 -> 2/4 over [1, 3], and stays to 5: (1/8 + 3/4 + 1) / 5.
    assert area_under_recall([3.0, 1.0, np.inf, 7.0], 5) == pytest.approx((1 / 8 + 3 / 4 + 1) / 5)
    assert area_under_recall([0.0, 0.0], 5) == 1
    assert area_under_recall([np.inf], 5) == 0
    assert np.isnan(area_under_recall([], 5))


@given(st.lists(st.floats(0, 30), min_size=1, max_size=20), st.floats(1, 20))
def test_the_area_under_recall_is_a_share_and_never_rises_with_a_failure(errors, bound):
    area = area_under_recall(errors, bound)
    assert 0 <= area <= 1
    assert area_under_recall([*errors, np.inf], bound) <= area


def test_the_error_of_the_best_returned_pose_is_measured_beside_that_of_the_first():
    scene = draw("general .15")
    wrong = (rotation_from_vector(np.array([0.5, 0, 0])) @ scene.R, scene.t)
    answer = judge("m", Estimate((wrong, (scene.R, scene.t)), 0.002, "planar"), scene.R, scene.t)
    assert (answer.kept, answer.time_ms) == (2, 2)
    assert answer.error_deg == pytest.approx(np.rad2deg(0.5))
    assert answer.kept_error_deg < 1e-5
    none = judge("m", Estimate((), 0.0, "none"), scene.R, scene.t)
    assert (none.error_deg, none.kept_error_deg) == (np.inf, np.inf)


def test_without_a_true_direction_the_error_is_that_of_the_rotation():
    backwards = Estimate(((np.eye(3), np.array([0.0, 0.0, -1.0])),), 0.0, "general")
    R, t = rotation_from_vector(np.array([0.0, np.deg2rad(2.0), 0.0])), np.array([0.0, 0.0, 1.0])
    assert judge("m", backwards, R, t, rotation_only=True).error_deg == pytest.approx(2)
    assert judge("m", Estimate((), 0.0, "none"), R, t, rotation_only=True).error_deg == np.inf


def test_the_oracle_is_exact_on_exact_data_and_infinite_for_a_rotation_only_camera():
    assert oracle_error_deg(draw("general .15", outlier_share=0.5), 1e-3) < 1e-4
    assert oracle_error_deg(draw("rotation"), 1e-3) == np.inf


def test_a_star_varies_one_factor_at_a_time():
    cells = star_grid(["a"], [0.1, 0.5, 0.7], [0.3, 0.7, 1.0], [100, 1000, 2000])
    assert len(cells) == len(set(cells)) == 7
    middle = Cell("a", 0.5, 0.7, 1000)
    differing = [
        sum(getattr(c, f) != getattr(middle, f) for f in ("outlier_share", "noise_px", "matches")) for c in cells
    ]
    assert sorted(differing) == [0, 1, 1, 1, 1, 1, 1]
    assert len(full_grid(["a", "b"], [0.1, 0.5], [0.3], [100, 200])) == 8


@pytest.mark.parametrize("method", available(list(METHODS))[0])
def test_every_method_finds_an_easy_pose_and_accepts_random_matches(method):
    scene = draw("general .15", 1, matches=200, outlier_share=0.1, noise_px=0.3)
    estimate = METHODS[method][1](scene.bearings1, scene.bearings2, 2 / FOCAL_PX, 0)
    assert max(pose_errors_deg(*estimate.poses[0], scene.R, scene.t)) < 2
    shuffled = scene.bearings2[np.random.default_rng(0).permutation(200)]
    nonsense = METHODS[method][1](scene.bearings1, shuffled, 2 / FOCAL_PX, 0)
    assert (nonsense.kind == "none") == (nonsense.poses == ())


def test_the_program_writes_what_it_prints_and_repeats_all_but_the_times(tmp_path, capsys):
    options = ["--scenes", "plane .15,rotation", "--outliers", "0.1", "--noise", "0.5", "--matches", "100"]
    options += ["--methods", "quest", "--trials", "2", "--out", str(tmp_path)]
    assert robust_comparison.main(options) == 0
    assert capsys.readouterr().out == (tmp_path / "robust_comparison.md").read_text()
    lines = (tmp_path / "robust_comparison.csv").read_text().splitlines()
    assert len(lines) == 1 + 4
    cells = star_grid(["plane .15", "rotation"], [0.1], [0.5], [100])
    runs = [list(run_trials(cells, ["quest"], 2, threshold_px=2.0, seed=0)) for _ in range(2)]
    assert [replace(t, time_ms=0) for t in runs[0]] == [replace(t, time_ms=0) for t in runs[1]]
