"""Methods that call the libraries of other authors: their settings, and their counts on the scenes of the table."""

import sys
import types

import numpy as np
import pytest
from make_window import point_source
from original_methods import ORIGINAL, ROWS, count_maps
from scipy.stats import fisher_exact
from two_view_scenes import CAMERA, make_scene

from slam_init.compare.measures import pose_errors
from slam_init.config import Config
from slam_init.methods import METHODS, make_initializer, make_two_view
from slam_init.methods.colmap import ColmapRules
from slam_init.methods.essential import GATED_PAIRS, GateRules
from slam_init.methods.poselib import relative_pose_of_poselib

PEERS = ("poselib", "poselib-100", "magsac", "superansac")


def peer(name):
    if METHODS[name].needs:
        pytest.importorskip(METHODS[name].needs)
    return make_two_view(name)


def outcome(two_view, scene):
    rays = CAMERA.bearings(scene.pixels1), CAMERA.bearings(scene.pixels2)
    return two_view.bootstrap(CAMERA, scene.pixels1, scene.pixels2, *rays, 0)


@pytest.mark.parametrize("name", PEERS)
def test_all_peers_have_the_same_gates(name):
    two_view = peer(name)
    assert two_view.gates == GateRules(min_in_front=50, min_parallax_deg=1.0)
    assert two_view.pair_rule == GATED_PAIRS


@pytest.mark.parametrize("name", PEERS)
@pytest.mark.parametrize(("kind", "baseline"), [("general", 0.03), ("general", 0.15), ("rotation", 0.15)])
def test_a_peer_solves_general_scenes_and_refuses_rotations(name, kind, baseline):
    peer(name)
    cell = count_maps(name, kind, baseline, scenes=5)
    assert (cell.correct, cell.false) == ((0, 0) if kind == "rotation" else (5, 0))


@pytest.mark.parametrize("name", ["poselib", "magsac"])
def test_the_counts_on_planes_are_those_of_the_table(name):
    peer(name)
    kind, baseline = ROWS[3]
    correct, false = ORIGINAL[METHODS[name].alias_of or name][3]
    cell = count_maps(name, kind, baseline, scenes=20)
    for here, original in ((cell.correct, correct), (cell.false, false)):
        assert fisher_exact([[here, 20 - here], [original, 50 - original]]).pvalue > 0.01


def test_poselib_100_draws_fewer_samples_and_poselib_as_many_as_its_default():
    poselib = pytest.importorskip("poselib")
    assert peer("poselib").min_iterations == poselib.RansacOptions()["min_iterations"] == 1000
    assert peer("poselib-100").min_iterations == 100


def test_superansac_has_the_defaults_of_its_package_but_for_the_order_of_the_matches():
    pysuperansac = pytest.importorskip("pysuperansac")
    defaults, rules = pysuperansac.RANSACSettings(), peer("superansac")
    assert rules.threshold_px == defaults.inlier_threshold
    assert rules.confidence == defaults.confidence
    assert (rules.min_iterations, rules.max_iterations) == (defaults.min_iterations, defaults.max_iterations)
    assert defaults.sampler == pysuperansac.SamplerType.PROSAC


def test_two_calls_of_superansac_give_nearly_the_same_rotation():
    peer("superansac")
    scene = make_scene("general", 0.15, 0)
    first, second = (outcome(peer("superansac"), scene) for _ in range(2))
    relative = first.cam2_from_cam1.R @ second.cam2_from_cam1.R.T
    assert np.rad2deg(np.arccos(np.clip((np.trace(relative) - 1) / 2, -1, 1))) < 0.2


@pytest.mark.parametrize(("scene", "seed"), [("room", 1), ("wall", 2), ("rotation", 3), ("static", 4)])
def test_the_window_judges_the_poses_of_poselib(scene, seed):
    pytest.importorskip("poselib")
    source = point_source(scene, seed, baseline=0.2, points=150)
    initializer = make_initializer("poselib-window", source.camera, Config())
    for observed in source.observations():
        if initializer.process_tracks(observed):
            break
    if scene in ("rotation", "static"):
        assert initializer.map is None
        return
    errors = pose_errors(initializer.map, source.groundtruth)
    assert errors.rotation_deg < 5 and errors.direction_deg < 15
    assert initializer.status.risk <= Config().acceptance.max_risk


def test_poselib_3_takes_one_dictionary_of_nested_options(monkeypatch):
    calls = []
    poselib_3 = types.SimpleNamespace(
        __version__="3.0.0",
        # Its signature: opt follows the cameras.
        estimate_relative_pose=lambda x1, x2, camera1, camera2, opt: calls.append(opt) or ("pose", {}),
    )
    monkeypatch.setitem(sys.modules, "poselib", poselib_3)
    points = np.zeros((5, 2))
    assert relative_pose_of_poselib(points, points, {}, 1.5, {"seed": 3}) == ("pose", {})
    assert calls == [{"max_error": 1.5, "ransac": {"seed": 3}}]


def test_the_rules_of_colmap_have_the_defaults_of_the_installed_colmap():
    pycolmap = pytest.importorskip("pycolmap")
    rules, pair, mapper = ColmapRules(), pycolmap.TwoViewGeometryOptions(), pycolmap.IncrementalMapperOptions()
    of_pair = (pair.max_H_inlier_ratio, pair.ransac.confidence, pair.ransac.max_num_trials)
    of_mapper = (
        mapper.init_max_error, mapper.init_min_num_inliers, mapper.init_max_forward_motion, mapper.init_min_tri_angle,
    )  # fmt: skip
    assert (rules.max_homography_ratio, rules.confidence, rules.max_iterations) == of_pair
    assert (rules.max_error_px, rules.min_inliers, rules.max_forward, rules.min_angle_deg) == of_mapper
