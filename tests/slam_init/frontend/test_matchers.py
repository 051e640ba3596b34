"""Matchers of two images, and the tracks that are made of their matches."""

import sys
from contextlib import nullcontext
from dataclasses import replace
from importlib.util import find_spec
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from make_map import CAMERAS
from make_source import synth

from slam_init import Config, Initializer
from slam_init.cli.main import main
from slam_init.errors import ConfigError
from slam_init.evaluation.metrics import compare_with_groundtruth
from slam_init.frontend.matched_tracks import MatchTracker, make_tracker
from slam_init.frontend.matchers import HlocMatcher, LightGlueMatcher, OrbMatcher, SiftMatcher, make_matcher
from slam_init.frontend.tracks import Tracker
from slam_init.types.frame import Frame

CAMERA = CAMERAS["pinhole"]


def frame(index, mask=None):
    """A frame whose first pixel is its index."""
    image = np.zeros((480, 640), np.uint8)
    image[0, 0] = index
    return Frame(index, index / 30, f"{index}", image, mask)


class Oracle:
    """Knows where each of some points is in each frame, and in which frames a detector misses it."""

    def __init__(self, points=60, seed=0, missed=0.3):
        rng = np.random.default_rng(seed)
        self.start, self.rng = rng.uniform((40, 40), (500, 400), (points, 2)), rng
        self.seen = rng.uniform(size=(30, points)) > missed

    def at(self, index):
        return self.start + np.array([4.0, 1.5]) * index

    def __call__(self, image1, image2):
        i, j = int(image1[0, 0]), int(image2[0, 0])
        both = np.flatnonzero(self.seen[i] & self.seen[j])
        both = self.rng.permutation(both)  # the order of matches means nothing
        return self.at(i)[both], self.at(j)[both], self.rng.uniform(size=len(both))


def tracks_of(tracker, oracle, count=12, masks=lambda _: None):
    """By frame of the history: which point each track shows."""
    for index in range(count):
        tracker.track(frame(index, masks(index)))
    found = {}
    for observed in tracker.history:
        distances = np.linalg.norm(observed.pixels[:, None] - oracle.at(observed.frame)[None], axis=2)
        assert (distances.min(axis=1, initial=np.inf) < 0.01).all() if len(observed) else True
        found[observed.frame] = dict(zip(observed.track_ids.tolist(), distances.argmin(axis=1).tolist(), strict=True))
    return found


def test_a_track_shows_one_point_and_goes_on_where_the_detector_missed_the_point():
    oracle = Oracle()
    tracks = tracks_of(MatchTracker(CAMERA, Config().tracking, oracle), oracle)
    point_of = {}
    for here in tracks.values():
        assert len(set(here.values())) == len(here)  # no point has two tracks in a frame
        for track, point in here.items():
            assert point_of.setdefault(track, point) == point
    # A point that was missed for a frame has one track all the same, since images further back are matched as well.
    lengths = [sum(track in here for here in tracks.values()) for track in point_of]
    assert np.median(lengths) >= 7
    assert len(point_of) < 1.2 * len(oracle.start)
    # The first frame got its tracks when the second one came.
    assert len(tracks[0]) > 0.5 * oracle.seen[0].sum()


def test_two_matches_of_a_point_leave_the_better_one_and_wrong_matches_put_no_point_twice_into_a_frame():
    oracle = Oracle(missed=0.0)

    def doubled(image1, image2):
        points1, points2, _ = oracle(image1, image2)
        wrong = np.roll(points2, 1, axis=0)
        scores = np.repeat([0.9, 0.2], len(points1))
        return np.vstack([points1, points1]), np.vstack([points2, wrong]), scores

    assert tracks_of(MatchTracker(CAMERA, Config().tracking, doubled), Oracle(missed=0.0)) != {}
    tracker = MatchTracker(CAMERA, Config().tracking, doubled)
    tracks = tracks_of(tracker, oracle, 4)
    assert all(here == tracks[0] for here in tracks.values()) and len(tracks[0]) == len(oracle.start)


def test_points_in_ignored_pixels_outside_of_the_image_and_without_a_score_have_no_track():
    mask = np.full((480, 640), 255, np.uint8)
    mask[:, :300] = 0
    oracle = Oracle(missed=0.0)
    tracks = tracks_of(MatchTracker(CAMERA, Config().tracking, oracle), oracle, 3, lambda _: mask)
    assert 0 < len(tracks[2]) == np.sum(oracle.at(2)[:, 0] > 302)
    # The mask of the first frame ignores points that later frames show.
    first = tracks_of(MatchTracker(CAMERA, Config().tracking, oracle), oracle, 3, lambda k: None if k else mask)
    assert len(first[0]) == np.sum(oracle.at(0)[:, 0] > 302) < len(first[2])

    def odd(image1, image2):
        points1, points2, scores = oracle(image1, image2)
        scores[:10], points2[10:20] = np.nan, 5000.0
        points1[20:30] = np.nan
        return points1, points2, scores

    tracker = MatchTracker(CAMERA, Config().tracking, odd)
    for index in range(2):
        observed = tracker.track(frame(index))
    assert len(observed) == len(oracle.start) - 30


@pytest.mark.parametrize(("make", "accuracy_px"), [(SiftMatcher, 0.5), (OrbMatcher, 4.0)])
def test_matches_of_a_shifted_image_have_its_shift(make, accuracy_px):
    """ORB's places are whole pixels of its pyramid, whose top has pixels of 3.6."""
    (one,) = synth("room", width=320, height=240).frames(0, 1)
    image = one.image
    shifted = np.ascontiguousarray(np.roll(image, (3, 7), axis=(0, 1)))
    points1, points2, scores = make()(image, shifted)
    assert len(points1) == len(points2) == len(scores) > 100
    moved = points2 - points1
    assert np.mean(np.linalg.norm(moved - (7, 3), axis=1) < accuracy_px) > 0.95
    np.testing.assert_allclose(np.median(moved, axis=0), (7, 3), atol=0.05)
    right = np.linalg.norm(moved - (7, 3), axis=1) < accuracy_px
    assert scores[right].mean() > 0.9


def test_an_initializer_with_a_matcher_finds_the_right_map():
    source = synth("room", width=320, height=240, slow_start=1)
    initializer = Initializer(source.camera, matcher=SiftMatcher())
    for one in source.frames(0, 30):
        if initializer.process(one):
            break
    errors = compare_with_groundtruth(initializer.map.keyframes, source.groundtruth)
    assert errors.rotation_error_deg < 5 and errors.direction_error_deg < 15


def test_the_command_takes_a_matcher_of_the_user_and_reports_what_is_wrong_with_one(tmp_path, capsys):
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "def none(image1, image2):\n    return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)\n"
        "def wrong(image1, image2):\n    return np.zeros((3, 2)), np.zeros((2, 2)), np.zeros(3)\n"
        "def fails(image1, image2):\n    raise RuntimeError('no weights')\n"
        "def nothing(image1, image2):\n    pass\n"
        "number = 3\n"
    )
    (tmp_path / "broken.py").write_text("this is no Python\n")
    options = ["--max-frames", "3", "--quiet", "--no-overview"]
    command = ["run", "synth:room?width=96&height=72&frames=3", *options, "--out"]

    def run(name):
        matcher = name if ":" not in name else str(tmp_path / name)
        code = main([*command, str(tmp_path / "out"), "--matcher", matcher])
        return code, capsys.readouterr().err

    assert run("mine.py:none") == (3, "")
    assert 'matcher = "' in (tmp_path / "out" / "config.toml").read_text()
    for name, message in (
        ("mine.py:wrong", "returned arrays of shapes ((3, 2), (2, 2), (3,)): give points (N, 2), (N, 2), scores (N,)"),
        ("mine.py:fails", "failed: RuntimeError: no weights"),
        ("mine.py:number", "is of the type int: give a callable of two images"),
        ("mine.py:nothing", "returned NoneType"),
        ("mine.py:absent", "mine.py has no attribute 'absent'"),
        ("broken.py:match", "cannot be loaded (invalid syntax (broken.py, line 1))"),
        ("surf", "unknown matcher 'surf': use sift, orb, lightglue, hloc"),
    ):
        code, error = run(name)
        assert code == 2 and message in error and error.count("\n") == 1, (name, error)
    frames, tracks = np.repeat([0, 1], 40), np.tile(np.arange(40), 2)
    xy = np.random.default_rng(0).uniform(0, 400, (80, 2))
    np.savez(tmp_path / "tracks.npz", frame=frames, track=tracks, xy=xy, size=np.array([640, 480]))
    assert main(["run", str(tmp_path / "tracks.npz"), "--out", str(tmp_path / "out"), "--matcher", "sift"]) == 2
    assert "has tracks of its own" in capsys.readouterr().err


def test_a_configuration_names_the_matcher_and_without_one_the_flow_follows_the_points():
    tracking = Config().tracking
    assert type(make_tracker(CAMERA, tracking)) is Tracker
    assert isinstance(make_tracker(CAMERA, replace(tracking, matcher="orb")), MatchTracker)
    assert isinstance(make_matcher("sift"), SiftMatcher)
    with pytest.raises(ConfigError, match="names are for"):
        Initializer(CAMERA, matcher="sift")


@pytest.mark.parametrize(("name", "package"), [("lightglue", "kornia"), ("hloc", "hloc")])
def test_a_matcher_whose_package_is_absent_says_what_to_install(name, package):
    if find_spec(package):
        pytest.skip(f"{package} is installed")
    with pytest.raises(ConfigError, match=f"install {package}"):
        make_matcher(name)


class Tensor(np.ndarray):
    """An array with the methods of a tensor that the adapters call."""

    def to(self, _):
        return self

    def float(self):
        return self.astype(np.float32)

    def cpu(self):
        return self

    def numpy(self):
        return np.asarray(self)


def tensor(values):
    return np.asarray(values).view(Tensor)


class Network:
    """A module of torch: what it was given, and what it answers."""

    def __init__(self, answer):
        self.answer, self.given = answer, []

    def eval(self):
        return self

    def to(self, _):
        return self

    def __call__(self, *given, **named):
        self.given.append((given, named))
        return self.answer(*given, **named)


KEYPOINTS = tensor([[10.0, 20.0], [30.0, 40.0], [50.0, 60.0]])


@pytest.fixture
def torch(monkeypatch):
    """A stand-in for torch, which the tests do not install."""
    module = ModuleType("torch")
    module.cuda = SimpleNamespace(is_available=lambda: False)
    module.device, module.inference_mode, module.from_numpy = str, nullcontext, tensor
    monkeypatch.setitem(sys.modules, "torch", module)
    return module


def test_hloc_gets_features_and_images_by_the_names_of_its_files(torch, monkeypatch):
    """The calls are those of hloc's extract_features.py and match_features.py."""
    detector = Network(lambda data: {"keypoints": [KEYPOINTS], "scores": [tensor(np.ones(3))],
                                     "descriptors": [tensor(np.ones((256, 3)))]})  # fmt: skip
    answer = {"matches0": tensor([[2, -1, 0]]), "matching_scores0": tensor([[0.9, 0.0, 0.4]])}
    matcher = Network(lambda _: answer)
    models = {"superpoint": lambda _: detector, "lightglue": lambda _: matcher}
    feature = {"model": {"name": "superpoint"}, "preprocessing": {"grayscale": True}}
    parts = {
        "hloc": {},
        "hloc.extract_features": {"confs": {"superpoint_aachen": feature}},
        "hloc.match_features": {"confs": {"superpoint+lightglue": {"model": {"name": "lightglue"}}}},
        "hloc.extractors": {},
        "hloc.matchers": {},
        "hloc.utils": {},
        "hloc.utils.base_model": {"dynamic_load": lambda _, name: models[name]},
    }
    for name, attributes in parts.items():
        module = ModuleType(name)
        module.__dict__.update(attributes)
        monkeypatch.setitem(sys.modules, name, module)
        if "." in name:
            setattr(sys.modules[name.rpartition(".")[0]], name.rpartition(".")[2], module)
    image1, image2 = (np.full((48, 64, 3), value, np.uint8) for value in (0, 255))
    points1, points2, scores = HlocMatcher()(image1, image2)
    np.testing.assert_array_equal(points1, KEYPOINTS[[0, 2]])
    np.testing.assert_array_equal(points2, KEYPOINTS[[2, 0]])
    np.testing.assert_array_equal(scores, [0.9, 0.4])
    ((given,), _) = matcher.given[0]
    assert {"keypoints0", "descriptors1", "scores0", "image0", "image1"} <= set(given)
    assert given["keypoints0"].shape == (1, 3, 2) and given["descriptors0"].shape == (1, 256, 3)
    assert given["image1"].shape == (1, 1, 48, 64) and given["image1"].max() == 1.0
    with pytest.raises(ConfigError, match="no configuration 'other'"):
        make_matcher("hloc:other,superpoint+lightglue")


def test_lightglue_gets_the_keypoints_of_disk_and_its_pairs_become_matches(torch, monkeypatch):
    """The calls are those of kornia 0.7; with its own code and random weights the adapter was run by hand."""
    disk = Network(lambda images, count, pad_if_not_divisible: [
        SimpleNamespace(keypoints=KEYPOINTS, descriptors=tensor(np.eye(3)))])  # fmt: skip
    lightglue = Network(lambda *_, **__: (tensor([[0.8], [0.3]]), tensor([[0, 1], [2, 0]])))
    module = ModuleType("kornia.feature")
    module.DISK = SimpleNamespace(from_pretrained=lambda _: disk)
    module.LightGlueMatcher = lambda _: lightglue
    module.laf_from_center_scale_ori = lambda centres: centres
    monkeypatch.setitem(sys.modules, "kornia", ModuleType("kornia"))
    monkeypatch.setitem(sys.modules, "kornia.feature", module)
    blue = np.zeros((48, 64, 3), np.uint8)
    blue[..., 0] = 255
    points1, points2, scores = LightGlueMatcher()(blue, blue[..., 0].copy())
    np.testing.assert_array_equal(points1, KEYPOINTS[[0, 2]])
    np.testing.assert_array_equal(points2, KEYPOINTS[[1, 0]])
    np.testing.assert_array_equal(scores, [0.8, 0.3])
    (first, *_), _ = disk.given[0]
    assert first.shape == (1, 3, 48, 64) and first[0, 2].min() == 1.0 and first[0, 0].max() == 0.0  # RGB
    _, named = lightglue.given[0]
    assert named == {"hw1": (48, 64), "hw2": (48, 64)}
