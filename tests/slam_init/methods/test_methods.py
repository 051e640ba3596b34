"""The methods of other systems: what each accepts and refuses on two views, and as initializers on tracks."""

import pickle
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from make_map import make_poses
from make_scene import CAMERA as TRACK_CAMERA
from make_scene import CONFIG, cloud, observe, plane, texture, window

from slam_init.benchmarks import heuristics_fidelity
from slam_init.benchmarks.heuristics_fidelity import fisher_p
from slam_init.benchmarks.two_view_scenes import CAMERA, KINDS, make_scene
from slam_init.config import Config
from slam_init.errors import ConfigError, SlamInitError
from slam_init.examples.add_a_method import MedianParallax
from slam_init.initializer import Initializer
from slam_init.methods import METHODS, MethodInfo, make_initializer, make_two_view, method_info
from slam_init.methods.pair_initializer import PairInitializer
from slam_init.methods.two_view import PairRule, TwoViewOutcome
from slam_init.runner import run
from slam_init.types.pose import Pose
from slam_init.types.reasons import ACCEPTED, REASONS

TWO_VIEW = [name for name, info in METHODS.items() if info.home]
#: COLMAP wants 16 degrees of parallax.
BASELINE = dict.fromkeys(TWO_VIEW, 0.15) | {"colmap": 0.6}
SEEDS = range(3)
#: By kind: the first pixel of the first view and the last one of the second.
EXPECTED_SCENES = {
    "general": [[336.34157727, 49.38720224], [60.73156529, 355.18337036]],
    "plane": [[335.63842634, 49.74014236], [571.25191659, 3.26636505]],
    "nadir": [[335.89143514, 51.43941919], [398.92502543, 92.1799578]],
    "rotation": [[336.34157727, 49.38720224], [629.32251979, 367.89854375]],
}


def method(name):
    if METHODS[name].needs:
        pytest.importorskip(METHODS[name].needs)
    return make_two_view(name)


def bootstrap(two_view, scene, seed=0):
    rays = CAMERA.bearings(scene.pixels1), CAMERA.bearings(scene.pixels2)
    return two_view.bootstrap(CAMERA, scene.pixels1, scene.pixels2, *rays, seed)


# -- two views ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TWO_VIEW)
def test_a_good_scene_is_accepted_and_right(name):
    two_view = method(name)
    outcomes = [
        (bootstrap(two_view, scene), scene) for scene in (make_scene("general", BASELINE[name], s) for s in SEEDS)
    ]
    accepted = [(outcome, scene) for outcome, scene in outcomes if outcome]
    assert len(accepted) >= 2
    for outcome, scene in accepted:
        assert outcome.reason == ACCEPTED
        assert scene.is_correct(outcome.cam2_from_cam1)
        assert np.linalg.norm(outcome.cam2_from_cam1.t) == pytest.approx(1)
        assert outcome.landmarks.sum() >= 50
        assert np.isfinite(outcome.points[outcome.landmarks]).all()
        assert np.isnan(outcome.points[~outcome.landmarks]).all()
        # A landmark projects to where it was seen; outliers that happen to lie on their lines are few.
        in2 = outcome.cam2_from_cam1.apply(outcome.points[outcome.landmarks])
        off_px = np.linalg.norm(CAMERA.project(in2) - scene.pixels2[outcome.landmarks], axis=1)
        assert np.median(off_px) < 2


@pytest.mark.parametrize("name", TWO_VIEW)
def test_a_turning_camera_is_refused_with_a_reason(name):
    """SVO has no test for it: four degrees are less than its 50 px."""
    for seed in SEEDS:
        outcome = bootstrap(method(name), make_scene("rotation", 0.0, seed))
        assert not outcome
        assert outcome.cam2_from_cam1 is None
        assert outcome.reason in ("low_parallax", "pure_rotation")
        assert not outcome.landmarks.any()


@pytest.mark.parametrize("name", TWO_VIEW)
def test_noise_alone_is_no_motion(name):
    rng = np.random.default_rng(0)
    scene = make_scene("general", 0.15, 0)
    scene = replace(scene, pixels2=rng.uniform((0, 0), (640, 480), scene.pixels2.shape))
    outcome = bootstrap(method(name), scene)
    assert not outcome
    assert outcome.reason in REASONS


def test_a_plane_is_what_tells_the_heuristics_apart():
    """ORB-SLAM2 takes the homography and refuses its twin; the others take what fits best, the twin included."""
    scenes = [make_scene("plane", 0.15, seed) for seed in range(6)]
    outcomes = [bootstrap(method("orb-slam2"), scene) for scene in scenes]
    assert [o.reason for o in outcomes].count("ambiguous_plane") >= 4
    assert all(scene.is_correct(o.cam2_from_cam1) for o, scene in zip(outcomes, scenes, strict=True) if o)
    five_point = [bootstrap(method("essential-5pt"), scene) for scene in scenes]
    right = [scene.is_correct(o.cam2_from_cam1) for o, scene in zip(five_point, scenes, strict=True) if o]
    assert len(right) >= 4
    assert 0 < sum(right) < len(right)


@pytest.mark.parametrize("name", TWO_VIEW)
def test_the_same_seed_gives_the_same_outcome(name):
    scene = make_scene("general", BASELINE[name], 1)
    first, second = (bootstrap(method(name), scene, seed=5) for _ in range(2))
    assert pickle.dumps(first) == pickle.dumps(second)


@pytest.mark.parametrize("name", TWO_VIEW)
@pytest.mark.parametrize("count", [0, 1, 3, 5])
def test_a_few_matches_are_too_few(name, count):
    scene = make_scene("general", 0.15, 0)
    scene = replace(scene, pixels1=scene.pixels1[:count], pixels2=scene.pixels2[:count])
    outcome = bootstrap(method(name), scene)
    assert not outcome
    assert outcome.reason in ("too_few_matches", "low_parallax", "no_consistent_motion")
    assert len(outcome.landmarks) == len(outcome.points) == count


@pytest.mark.parametrize("name", TWO_VIEW)
@pytest.mark.parametrize("degenerate", ["one point", "a line", "a still camera"])
def test_a_degenerate_pair_is_refused_without_an_exception(name, degenerate):
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
def test_bad_arrays_are_the_callers_mistake(name):
    scene = make_scene("general", 0.15, 0)
    rays = CAMERA.bearings(scene.pixels1), CAMERA.bearings(scene.pixels2)
    with pytest.raises(SlamInitError, match="shapes"):
        method(name).bootstrap(CAMERA, scene.pixels1[:-1], scene.pixels2, *rays, 0)
    broken = scene.pixels2.copy()
    broken[3, 0] = np.nan
    with pytest.raises(SlamInitError, match="not finite"):
        method(name).bootstrap(CAMERA, scene.pixels1, broken, *rays, 0)


# -- as initializers, on tracks --------------------------------------------------------------------


def tracks_of(points, noise_px=0.3, count=8):
    return observe(TRACK_CAMERA, make_poses(count), points, noise_px, np.random.default_rng(1))


def feed(initializer, observations):
    for observed in observations:
        initializer.process_tracks(observed)
        if initializer.map is not None:
            break
    return initializer.finish()


@pytest.mark.parametrize("name", [n for n in METHODS if n not in ("colmap", "homography")])
def test_every_method_makes_a_map_of_tracks(name):
    if METHODS[name].needs:
        pytest.importorskip(METHODS[name].needs)
    initializer = make_initializer(name, TRACK_CAMERA, CONFIG)
    result = feed(initializer, tracks_of(cloud(np.random.default_rng(0), 300)))
    assert result, result.reason
    assert initializer.frames_read == result.frames_to_init
    first, *others = result.map.keyframes
    np.testing.assert_allclose(first.world_from_cam.R, np.eye(3), atol=1e-6)
    truth = make_poses(8)
    for keyframe in others:
        true = truth[first.frame].inverse() @ truth[keyframe.frame]
        cosine = keyframe.world_from_cam.t @ true.t
        assert cosine > np.cos(np.deg2rad(5)) * np.linalg.norm(keyframe.world_from_cam.t) * np.linalg.norm(true.t)
    assert result.map.graph.size() > 0
    assert len(result.map.colors) == len(result.map.points)
    assert (result.map.colors == 128).all()  # tracks without colors are grey


def test_without_a_third_view_the_pair_is_enough():
    """A wide pair at the end of a sequence: quest waits until it ends, quest-two-view takes it at once."""
    first, *_, last = tracks_of(cloud(np.random.default_rng(0), 300))
    waiting, taking = (make_initializer(name, TRACK_CAMERA, CONFIG) for name in ("quest", "quest-two-view"))
    for initializer in (waiting, taking):
        initializer.process_tracks(first)
        initializer.process_tracks(last)
    assert waiting.map is None
    assert taking.map is not None
    assert taking.finish().attempts[-1].verdict == ACCEPTED


class Scripted:
    """A method that refuses everything."""

    pair_rule = PairRule(min_features=100, min_matches=60, min_landmarks=50)

    def bootstrap(self, camera, pixels1, pixels2, bearings1, bearings2, seed):
        return TwoViewOutcome.refused("low_parallax", len(pixels1), {"seen": len(pixels1)})


def test_the_reference_stays_until_its_tracks_are_lost():
    observations = tracks_of(cloud(np.random.default_rng(0), 200))
    lost = [replace(o, track_ids=o.track_ids + (1000 if k >= 4 else 0)) for k, o in enumerate(observations)]
    initializer = PairInitializer(Scripted(), TRACK_CAMERA, CONFIG)
    attempts = [initializer.process_tracks(observed).attempt for observed in lost]
    assert attempts[0] is None
    assert [attempt.frames for attempt in attempts[1:]] == [(0, 1), (0, 2), (0, 3), (0, 4), (4, 5), (4, 6), (4, 7)]
    assert attempts[4].verdict == "too_few_matches"
    assert attempts[5].evidence["seen"] == 200
    assert initializer.finish().reason == "low_parallax"


def test_a_reference_needs_features():
    observations = tracks_of(cloud(np.random.default_rng(0), 90))
    initializer = PairInitializer(Scripted(), TRACK_CAMERA, CONFIG)
    assert not feed(initializer, observations)
    assert initializer.finish().reason == "too_few_features"
    assert PairInitializer(Scripted(), TRACK_CAMERA, CONFIG).finish().reason == "too_few_frames"


def test_a_wrong_motion_does_not_survive_bundle_adjustment():
    class Wrong(Scripted):
        def bootstrap(self, camera, pixels1, pixels2, bearings1, bearings2, seed):
            points = np.column_stack([bearings1[:, :2], -bearings1[:, 2]])  # behind the camera
            return TwoViewOutcome.accepted(
                Pose(np.eye(3), np.array([1.0, 0, 0])), np.ones(len(points), bool), points, False, {}
            )

    result = feed(PairInitializer(Wrong(), TRACK_CAMERA, CONFIG), tracks_of(plane(np.random.default_rng(0), 200)))
    assert not result
    assert result.reason == "bundle_adjustment_failed"


# -- tracks in place of images ---------------------------------------------------------------------


def sampled(result):
    """All that a result holds but times, as bytes."""
    map_ = result.map
    graph = map_.graph.serialize() if map_ is not None else ""
    values = map_.values.serialize() if map_ is not None else ""
    plain = None if map_ is None else replace(map_, graph=None, values=None)
    return pickle.dumps((graph, values, plain, result.reason, result.frames_read, result.attempts))


def jumping_frames():
    """Windows on a texture that are too far apart for flow: descriptors link them, and enrich the frames before."""
    image = texture(0, 480, 1500)
    return [window(image, 170 * k, 0, 640, 480, k) for k in range(5)]


@pytest.mark.parametrize(("name", "jumping"), [("quest", False), ("orb-slam3", False), ("quest", True)])
def test_tracks_fed_are_as_good_as_images(room, name, jumping):
    frames = jumping_frames() if jumping else room.frames(0, 20)
    seeing = make_initializer(name, room.camera, CONFIG)
    fed, revisions = [], 0
    for frame in frames:
        seeing.process(frame)
        fed.append((seeing.history[frame.index], seeing.tracker.revised))
        revisions += len(seeing.tracker.revised)
        if seeing.map is not None:
            break
    assert (revisions > 0) == jumping
    # What the tracker said at the time, not what it knew later.
    blind = make_initializer(name, room.camera, CONFIG)
    for current, revised in fed:
        blind.process_tracks(current, revised)
    assert sampled(seeing.finish()) == sampled(blind.finish())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"track_ids": np.zeros(120, int)}, "strictly increasing"),
        ({"track_ids": np.arange(7)}, "shapes"),
        ({"pixels": np.full((120, 2), np.nan)}, "not finite"),
        ({"colors": np.zeros((3, 3), np.uint8)}, "colors"),
        ({"frame": 0}, "ascending"),
        ({"frame": -4}, "ascending"),
    ],
)
def test_tracks_that_make_no_sense_are_refused(change, message):
    first, second, *_ = tracks_of(cloud(np.random.default_rng(0), 120))
    initializer = Initializer(TRACK_CAMERA)
    initializer.process_tracks(first)
    with pytest.raises(SlamInitError, match=message):
        initializer.process_tracks(replace(second, **change))
    assert initializer.frames_read == 1


def test_a_revision_of_a_frame_that_was_not_fed_is_passed_over():
    observations = tracks_of(cloud(np.random.default_rng(0), 120))
    initializer = Initializer(TRACK_CAMERA)
    for current in observations[2:5]:
        initializer.process_tracks(current, revised=(observations[0], observations[2]))
    assert len(initializer.history) == 3


# -- names -----------------------------------------------------------------------------------------


def test_every_method_is_described():
    for name, info in METHODS.items():
        assert info.name == name
        assert info.summary
        assert info.source
        if info.needs is None or find_spec(info.needs):
            assert make_initializer(name, TRACK_CAMERA, CONFIG).frames_read == 0


def test_names_that_are_no_method_are_refused(monkeypatch):
    for name, message in [
        ("magic", "use one of quest"),
        ("no_such_module:Method", "cannot be made"),
        ("slam_init.types.arrays:Nothing", "cannot be made"),
        ("slam_init.types.arrays:Pose", "cannot be made"),
        ("slam_init.config:Config", "no two-view method"),
        ("quest", "use make_initializer"),
    ]:
        with pytest.raises(ConfigError, match=message):
            make_two_view(name)
    monkeypatch.setitem(METHODS, "rare", MethodInfo("rare", "-", "-", "slam_init.config:Config", "no_such_package"))
    with pytest.raises(ConfigError, match="pip install no_such_package"):
        make_two_view("rare")


def test_a_method_of_your_own_is_taken_by_its_path(room, tmp_path):
    """The example, as the command line runs it; the summary and the configuration tell the method."""
    name = "slam_init.examples.add_a_method:MedianParallax"
    assert method_info(name).home == name
    assert isinstance(make_two_view(name), MedianParallax)
    result, summary = run(room, room.camera, Config(method=name), out=tmp_path)
    assert result
    assert summary["method"] == name
    assert summary["ground_truth"]["direction_error_deg"] < 5
    assert name in (tmp_path / "config.toml").read_text()
    assert (tmp_path / "recording.rrd").stat().st_size > 0


# -- fidelity --------------------------------------------------------------------------------------


def test_the_scenes_are_those_of_the_table():
    """The order of the draws is part of their definition: these pixels were printed by the program of the table."""
    for kind in KINDS:
        scene = make_scene(kind, 0.15, 7000)
        assert len(scene.pixels1) == 400
        assert (~scene.inliers).sum() == 40
        np.testing.assert_allclose([scene.pixels1[0], scene.pixels2[399]], EXPECTED_SCENES[kind], atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_the_scenes_obey_their_own_truth(kind):
    scene = make_scene(kind, 0.2, 3, noise_px=0.0)
    m, n = CAMERA.bearings(scene.pixels1)[scene.inliers], CAMERA.bearings(scene.pixels2)[scene.inliers]
    rotated, t = m @ scene.cam2_from_cam1.R.T, scene.cam2_from_cam1.t
    if kind == "rotation":
        np.testing.assert_allclose(rotated, n, atol=1e-9)
        assert not scene.is_correct(scene.cam2_from_cam1)
    else:
        np.testing.assert_allclose(np.cross(rotated, n) @ t, 0, atol=1e-9)
        assert scene.is_correct(scene.cam2_from_cam1)
        assert not scene.is_correct(Pose(scene.cam2_from_cam1.R, -t))
    with pytest.raises(ValueError, match="use one of general"):
        make_scene("cube", 0.2, 3)


def test_fishers_test_is_that_of_the_textbook():
    """The lady tasting tea: three of four cups right."""
    assert fisher_p(3, 4, 1, 4) == pytest.approx(34 / 70)
    assert fisher_p(4, 4, 0, 4) == pytest.approx(2 / 70)
    assert fisher_p(7, 50, 7, 50) == 1


def test_the_program_prints_its_table(tmp_path, capsys):
    out = tmp_path / "new"
    assert heuristics_fidelity.main(["--scenes", "2", "--methods", "stella", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert (out / "heuristics_fidelity.md").read_text() == printed
    assert "| general 0.03" in printed
    with pytest.raises(SystemExit):
        heuristics_fidelity.main(["--methods", "quest"])
