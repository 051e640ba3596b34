"""Laws of all two-view methods: which pairs they accept and refuse, and the outcome that they return."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from two_view_scenes import CAMERA, make_scene

from slam_init.errors import SlamInitError
from slam_init.methods import METHODS, make_two_view
from slam_init.methods.two_view import TwoViewOutcome, check_matches, undistorted_pixels
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose
from slam_init.types.reasons import REASONS, Verdict

TWO_VIEW = [name for name, info in METHODS.items() if info.home]
#: COLMAP requires 16 degrees of parallax.
BASELINE = dict.fromkeys(TWO_VIEW, 0.15) | {"colmap": 0.6}
#: pySLAM takes 150 matches within 0.2 px: of 400 matches with a noise of 0.7 px, 70 are.
COUNT = dict.fromkeys(TWO_VIEW, 400) | {"pyslam": 1500}
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
        (bootstrap(two_view, scene), scene)
        for scene in (make_scene("general", BASELINE[name], s, COUNT[name]) for s in SEEDS)
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
        outcome = bootstrap(method(name), make_scene("rotation", 0.0, seed, COUNT[name]))
        assert not outcome
        assert outcome.cam2_from_cam1 is None
        assert outcome.reason in ("low_parallax", "pure_rotation")
        assert not outcome.landmarks.any()


@pytest.mark.parametrize("name", TWO_VIEW)
def test_unrelated_pixels_have_no_motion(name):
    rng = np.random.default_rng(0)
    scene = make_scene("general", 0.15, 0)
    scene = replace(scene, pixels2=rng.uniform((0, 0), (640, 480), scene.pixels2.shape))
    outcome = bootstrap(method(name), scene)
    assert not outcome
    assert outcome.reason in REASONS


def test_on_a_plane_orb_slam2_refuses_the_ambiguity_and_the_five_point_method_takes_either_motion():
    scenes = [make_scene("plane", 0.15, seed) for seed in range(6)]
    outcomes = [bootstrap(method("orb-slam2"), scene) for scene in scenes]
    assert [o.reason for o in outcomes].count("ambiguous_plane") >= 4
    assert all(scene.is_correct(o.cam2_from_cam1) for o, scene in zip(outcomes, scenes, strict=True) if o)
    five_point = [bootstrap(method("essential-5pt"), scene) for scene in scenes]
    correct = [scene.is_correct(o.cam2_from_cam1) for o, scene in zip(five_point, scenes, strict=True) if o]
    assert len(correct) >= 4
    assert 0 < sum(correct) < len(correct)


@pytest.mark.parametrize("name", [name for name in TWO_VIEW if name != "superansac"])  # its package takes no seed
def test_the_same_seed_gives_the_same_outcome(name):
    scene = make_scene("general", BASELINE[name], 1)
    first, second = (bootstrap(method(name), scene, seed=5) for _ in range(2))
    assert pickle.dumps(first) == pickle.dumps(second)


@pytest.mark.parametrize("name", TWO_VIEW)
@pytest.mark.parametrize("count", [0, 1, 3, 5])
def test_a_few_matches_are_refused(name, count):
    scene = make_scene("general", 0.15, 0)
    scene = replace(scene, pixels1=scene.pixels1[:count], pixels2=scene.pixels2[:count])
    outcome = bootstrap(method(name), scene)
    assert not outcome
    assert outcome.reason in ("too_few_matches", "low_parallax", "no_consistent_motion")
    assert len(outcome.landmarks) == len(outcome.points) == count


@pytest.mark.parametrize("name", TWO_VIEW)
@pytest.mark.parametrize("degenerate", ["one point", "a line", "a static camera"])
def test_a_degenerate_pair_raises_no_exception_and_is_refused_unless_it_is_a_line(name, degenerate):
    scene = make_scene("general", 0.15, 0)
    pixels1, pixels2 = scene.pixels1.copy(), scene.pixels2.copy()
    if degenerate == "one point":
        pixels1[:], pixels2[:] = pixels1[0], pixels2[0]
    elif degenerate == "a line":
        pixels1[:, 1], pixels2[:, 1] = 240.0, 250.0
    else:
        pixels2 = pixels1.copy()
    outcome = bootstrap(method(name), replace(scene, pixels1=pixels1, pixels2=pixels2))
    assert not outcome or degenerate == "a line"


@pytest.mark.parametrize("name", TWO_VIEW)
def test_inconsistent_arrays_are_an_error(name):
    scene = make_scene("general", 0.15, 0)
    rays = CAMERA.bearings(scene.pixels1), CAMERA.bearings(scene.pixels2)
    with pytest.raises(SlamInitError, match="shapes"):
        method(name).bootstrap(CAMERA, scene.pixels1[:-1], scene.pixels2, *rays, 0)
    broken = scene.pixels2.copy()
    broken[3, 0] = np.nan
    with pytest.raises(SlamInitError, match="not finite"):
        method(name).bootstrap(CAMERA, scene.pixels1, broken, *rays, 0)


# -- the interface --------------------------------------------------------------------------------


def test_a_method_may_give_its_reason_as_text_and_an_unknown_reason_is_an_error():
    assert TwoViewOutcome.refused("low_parallax", 3).verdict is Verdict.LOW_PARALLAX
    assert TwoViewOutcome.refused(Verdict.LOW_PARALLAX, 3).reason == "low_parallax"
    with pytest.raises(SlamInitError, match="unknown reason 'tired'"):
        _ = TwoViewOutcome.refused("tired", 3).verdict


def test_an_accepted_outcome_has_points_for_its_landmarks_only():
    landmarks = np.array([True, False, True])
    outcome = TwoViewOutcome.accepted(Pose.identity(), landmarks, np.ones((3, 3)), False, {"score": 1.0})
    assert outcome
    assert np.isfinite(outcome.points[landmarks]).all()
    assert np.isnan(outcome.points[~landmarks]).all()
    assert not TwoViewOutcome.refused("low_parallax", 3)


def test_undistorted_pixels_are_those_of_the_camera_without_its_distortion():
    camera = Camera("radtan", 640, 480, 500.0, 510.0, 321.5, 238.25, (-0.2, 0.05, 1e-3, -5e-4))
    rng = np.random.default_rng(0)
    bearings = camera.bearings(rng.uniform((0, 0), (640, 480), (20, 2)))
    ideal = replace(camera, model="pinhole", distortion=())
    np.testing.assert_allclose(undistorted_pixels(camera, bearings), ideal.project(bearings))
    assert check_matches(ideal.project(bearings), ideal.project(bearings), bearings, bearings) == 20
