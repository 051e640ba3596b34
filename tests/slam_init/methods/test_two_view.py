"""Laws of all two-view methods: which pairs they accept and refuse, and the outcome that they return."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from make_window import point_source
from two_view_scenes import CAMERA, make_scene

from slam_init.compare.measures import pose_errors
from slam_init.config import Config
from slam_init.errors import SlamInitError
from slam_init.methods import METHODS, make_initializer, make_two_view
from slam_init.methods.sfm_systems import Colmap, OpenSfm
from slam_init.types.refusal import REASONS, Verdict

TWO_VIEW = [name for name, info in METHODS.items() if info.home]
#: COLMAP requires 16 degrees of parallax.
BASELINE = dict.fromkeys(TWO_VIEW, 0.15) | {"colmap": 0.6}
SEEDS = range(3)


def method(name):
    if METHODS[name].needs:
        pytest.importorskip(METHODS[name].needs)
    return make_two_view(name)


def bootstrap(two_view, scene, seed=0):
    rays = CAMERA.bearings(scene.pixels1), CAMERA.bearings(scene.pixels2)
    return two_view.bootstrap(CAMERA, scene.pixels1, scene.pixels2, *rays, seed)


@pytest.mark.parametrize("name", TWO_VIEW)
def test_a_good_scene_is_accepted_with_a_correct_motion(name):
    two_view = method(name)
    outcomes = [
        (bootstrap(two_view, scene), scene) for scene in (make_scene("general", BASELINE[name], s) for s in SEEDS)
    ]
    accepted = [(outcome, scene) for outcome, scene in outcomes if outcome]
    assert len(accepted) >= 2
    for outcome, scene in accepted:
        assert outcome.verdict is Verdict.ACCEPTED
        assert scene.is_correct(outcome.cam2_from_cam1)
        assert np.linalg.norm(outcome.cam2_from_cam1.t) == pytest.approx(1)
        assert outcome.landmarks.sum() >= 50
        assert np.isfinite(outcome.points[outcome.landmarks]).all()
        assert np.isnan(outcome.points[~outcome.landmarks]).all()
        # A landmark projects to its pixel in the second view. Few outliers lie on their epipolar lines by chance.
        in2 = outcome.cam2_from_cam1.apply(outcome.points[outcome.landmarks])
        off_px = np.linalg.norm(CAMERA.project(in2) - scene.pixels2[outcome.landmarks], axis=1)
        assert np.median(off_px) < 2


@pytest.mark.parametrize("name", TWO_VIEW)
def test_a_rotation_only_camera_is_refused_with_a_reason(name):
    """SVO has no test for it, but a rotation of four degrees moves the tracks by less than its 50 px."""
    for seed in SEEDS:
        outcome = bootstrap(method(name), make_scene("rotation", 0.0, seed))
        assert not outcome
        assert outcome.cam2_from_cam1 is None
        assert outcome.reason in ("low_parallax", "pure_rotation")
        assert not outcome.landmarks.any()


@pytest.mark.parametrize("name", TWO_VIEW)
def test_unrelated_pixels_have_no_motion_and_the_same_seed_gives_the_same_outcome(name):
    rng, two_view = np.random.default_rng(0), method(name)
    scene = make_scene("general", 0.15, 0)
    outcome = bootstrap(two_view, replace(scene, pixels2=rng.uniform((0, 0), (640, 480), scene.pixels2.shape)))
    assert not outcome
    assert outcome.reason in REASONS
    scene = make_scene("general", BASELINE[name], 1)
    first, second = (bootstrap(method(name), scene, seed=5) for _ in range(2))
    assert pickle.dumps(first) == pickle.dumps(second)


def test_on_a_plane_orb_slam2_refuses_the_ambiguity_and_the_five_point_method_takes_either_motion():
    scenes = [make_scene("plane", 0.15, seed) for seed in range(6)]
    outcomes = [bootstrap(method("orb-slam2"), scene) for scene in scenes]
    assert [o.reason for o in outcomes].count("ambiguous_plane") >= 4
    assert all(scene.is_correct(o.cam2_from_cam1) for o, scene in zip(outcomes, scenes, strict=True) if o)
    five_point = [bootstrap(method("essential-5pt"), scene) for scene in scenes]
    correct = [scene.is_correct(o.cam2_from_cam1) for o, scene in zip(five_point, scenes, strict=True) if o]
    assert len(correct) >= 4
    assert 0 < sum(correct) < len(correct)


@pytest.mark.parametrize("name", TWO_VIEW)
def test_few_matches_and_degenerate_pairs_are_refused_without_an_exception(name):
    """Pixels on a line may be accepted."""
    two_view, scene = method(name), make_scene("general", 0.15, 0)
    for count in (0, 1, 3, 5):
        outcome = bootstrap(two_view, replace(scene, pixels1=scene.pixels1[:count], pixels2=scene.pixels2[:count]))
        assert not outcome
        assert outcome.reason in ("too_few_matches", "low_parallax", "no_consistent_motion")
        assert len(outcome.landmarks) == len(outcome.points) == count
    one_point = replace(scene, pixels1=scene.pixels1 * 0 + 100.0, pixels2=scene.pixels2 * 0 + 120.0)
    assert not bootstrap(two_view, one_point)
    assert not bootstrap(two_view, replace(scene, pixels2=scene.pixels1.copy()))  # a static camera
    on_line = (np.column_stack([x[:, 0], np.full(len(x), 240.0)]) for x in (scene.pixels1, scene.pixels2))
    outcome = bootstrap(two_view, replace(scene, **dict(zip(("pixels1", "pixels2"), on_line, strict=True))))
    assert outcome or outcome.reason in REASONS


def test_inconsistent_arrays_are_an_error():
    scene = make_scene("general", 0.15, 0)
    rays = CAMERA.bearings(scene.pixels1), CAMERA.bearings(scene.pixels2)
    with pytest.raises(SlamInitError, match="shapes"):
        method("stella").bootstrap(CAMERA, scene.pixels1[:-1], scene.pixels2, *rays, 0)
    broken = scene.pixels2.copy()
    broken[3, 0] = np.nan
    with pytest.raises(SlamInitError, match="not finite"):
        method("colmap").bootstrap(CAMERA, scene.pixels1, broken, *rays, 0)


# -- methods that call the libraries of other authors, and OpenSfM's rules ---------------------------------------


@pytest.mark.parametrize(("scene", "seed"), [("room", 1), ("wall", 2), ("rotation", 3)])
def test_the_window_evaluates_the_poses_of_poselib(scene, seed):
    pytest.importorskip("poselib")
    source = point_source(scene, seed, baseline=0.2, points=150)
    initializer = make_initializer("poselib-window", source.camera, Config())
    for observed in source.observations():
        if initializer.process_tracks(observed):
            break
    if scene == "rotation":
        assert initializer.map is None
        return
    errors = pose_errors(initializer.map, source.groundtruth)
    assert errors.rotation_deg < 5 and errors.direction_deg < 15
    assert initializer.status.risk <= Config().acceptance.max_risk


def test_the_rules_of_colmap_have_the_defaults_of_the_installed_colmap():
    pycolmap = pytest.importorskip("pycolmap")
    rules, pair, mapper = Colmap(), pycolmap.TwoViewGeometryOptions(), pycolmap.IncrementalMapperOptions()
    of_pair = (pair.max_H_inlier_ratio, pair.ransac.confidence, pair.ransac.max_num_trials)
    of_mapper = (
        mapper.init_max_error, mapper.init_min_num_inliers, mapper.init_max_forward_motion, mapper.init_min_tri_angle,
    )  # fmt: skip
    assert (rules.max_homography_ratio, rules.confidence, rules.max_iterations) == of_pair
    assert (rules.max_error_px, rules.min_inliers, rules.max_forward, rules.min_angle_deg) == of_mapper


# -- OpenSfM: the counts of the original program are not known, so these are tests of its rules ------------------


def test_opensfm_tries_a_pair_that_contradicts_a_rotation_and_its_landmarks_have_an_angle_of_a_degree():
    refused = bootstrap(OpenSfm(), make_scene("rotation", 0.15, 7000))
    assert refused.reason == "low_parallax"
    assert refused.evidence["outlier_ratio"] < refused.evidence["outlier_ratio_gate"] == 0.3
    scene = make_scene("general", 0.15, 7002)
    found = bootstrap(OpenSfm(), scene)
    assert found.evidence["outlier_ratio"] >= 0.3
    m, n = CAMERA.bearings(scene.pixels1), CAMERA.bearings(scene.pixels2)
    cosines = np.sum((m @ found.cam2_from_cam1.R.T) * n, axis=1)[found.landmarks]
    assert found.landmarks.sum() >= 20 and np.degrees(np.arccos(cosines)).min() >= 1.0
