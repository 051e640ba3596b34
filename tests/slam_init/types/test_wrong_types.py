"""What is made of wrong types is refused at once, in one line that names the part and what to give."""

import numpy as np
import pytest

import slam_init
from slam_init import SlamInitError
from slam_init.types.scale import ScaleOrigin

ONE = np.ones((1, 3))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: slam_init.Camera(["pinhole"], 64, 48, 60.0, 60.0, 31.5, 23.5), "unknown camera model"),
        (lambda: slam_init.Camera("radtan", 64, 48, 60.0, 60.0, 31.5, 23.5, "0.1"), "give a tuple of numbers"),
        (lambda: slam_init.Pose(None, np.zeros(3)), "R of a pose has the type NoneType"),
        (
            lambda: slam_init.Pose(np.eye(4), np.zeros(3)),
            r"R of a pose has the shape \(4, 4\): give an array of the shape \(3, 3\)",
        ),
        (lambda: slam_init.Pose(np.eye(3), [0.0, 0.0, 0.0]), "t of a pose has the type list"),
        (lambda: slam_init.Trajectory(1, 2), "the times as an array"),
        (lambda: slam_init.Trajectory(np.zeros(2), (slam_init.Pose.identity(),)), "2 times for 1 poses"),
        (lambda: slam_init.Trajectory(np.zeros(1), (np.eye(4),)), "give a Pose for each time"),
        (lambda: slam_init.Observations(0, 0.0, "", np.arange(2), ONE[:, :2], ONE), r"pixels .* shape \(1, 2\)"),
        (lambda: slam_init.Config(map=5), "map is of the type int: give a MapConfig"),
        (lambda: slam_init.open_source(5), "type int: give a path"),
        (lambda: slam_init.open_source(None), "type NoneType: give a path"),
        (lambda: slam_init.run("video.mp4"), r"type str: open it by slam_init.open_source"),
    ],
)
def test_a_wrong_type_is_one_line(make, words):
    with pytest.raises(SlamInitError, match=words) as message:
        make()
    assert "\n" not in str(message.value)


def run_room(**options):
    slam_init.run(slam_init.open_source("synth:room"), **options)


A_MAP, A_FOLDER = "the map is of the type", "is of the type .*: give text, or a pathlib.Path"


@pytest.mark.parametrize("wrong", [None, 1.5, [], object()], ids=["None", "number", "list", "object"])
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (slam_init.load_graph, A_FOLDER),
        (slam_init.load_camera, A_FOLDER),
        (lambda it: slam_init.load_config([] if it is None else it), A_FOLDER),
        (lambda it: slam_init.export(it, "out"), f"{A_MAP} .*: give result.map"),
        (lambda it: slam_init.write_colmap(it, "out"), A_MAP),
        (slam_init.pycolmap_reconstruction, A_MAP),
        (lambda it: slam_init.find_scale(it, slam_init.parse_scale("height:1")), A_MAP),
        (lambda it: slam_init.in_metres(it, None), A_MAP),
        (slam_init.parse_scale, "the scale is of the type .*: give text"),
        (slam_init.prior_camera, r"give \(width, height\)"),
        (lambda it: run_room(start=it or "0"), "start is .*: give an integer from 0 on"),
        (lambda it: run_room(continue_frames=it or "9"), "continue_frames is"),
        (lambda it: run_room(config=it or "x"), "the configuration is of the type"),
        (lambda it: run_room(scale=it or "x"), "the scale is of the type"),
        (lambda it: run_room(imu=it or "x"), "imu is of the type"),
        (lambda it: run_room(export=it or "scene"), r"give a list, as in \['scene'\]"),
    ],
)
def test_each_door_refuses_what_it_cannot_take(call, words, wrong, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SlamInitError, match=words) as message:
        call(wrong)
    assert "\n" not in str(message.value)
    assert list(tmp_path.iterdir()) == []


WRONG_IMAGES = [None, "a.png", np.zeros((480, 640)), np.zeros((480, 640, 4), np.uint8), np.zeros((48, 64), np.uint8)]


@pytest.mark.parametrize("image", WRONG_IMAGES, ids=["None", "text", "float", "alpha", "small"])
def test_an_image_that_is_none_of_the_camera_is_refused(image, room_run, tmp_path):
    map_ = room_run.result.map
    images = {keyframe.frame: image for keyframe in map_.keyframes}
    with pytest.raises(SlamInitError, match=r"the image of frame 0 .*: (give uint8, |if they are)"):
        slam_init.export(map_, tmp_path / "out", ["scene"], images=images)
    with pytest.raises(SlamInitError, match="the image of frame 0"):
        slam_init.find_scale(map_, slam_init.parse_scale("marker:tag36h11:0.1"), images=images)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("metres", "sigma"), [(np.nan, 0.1), (0.0, 0.1), (-2.0, 0.1), (np.inf, 0.1), ("2", 0.1), (2.0, -0.1), (2.0, np.nan)]
)
def test_no_map_is_scaled_by_what_is_no_scale(metres, sigma, room_run):
    with pytest.raises(SlamInitError, match=r"the scale has .*: give positive numbers"):
        slam_init.in_metres(room_run.result.map, slam_init.Scale(ScaleOrigin.DISTANCE, metres, sigma))


@pytest.mark.parametrize("further", [{"images": [1]}, {"groundtruth": "x"}, {"imu": "x"}, {"located": ["x"]}])
def test_the_request_of_a_scale_has_its_type(further, room_run):
    with pytest.raises(SlamInitError, match="is of the type"):
        slam_init.find_scale(room_run.result.map, slam_init.parse_scale("distance:1"), **further)


def test_an_initializer_takes_images_or_tracks_and_not_both():
    image = np.random.default_rng(0).integers(0, 256, (48, 64), np.uint8)
    camera = slam_init.Camera("pinhole", 64, 48, 60.0, 60.0, 31.5, 23.5)
    of_tracks, of_images = slam_init.Initializer(camera), slam_init.Initializer(camera)
    pixels = np.array([[10.0, 10.0], [20.0, 30.0]])
    seen = [slam_init.Observations(k, float(k), "", np.arange(2), pixels, camera.bearings(pixels)) for k in range(3)]
    of_tracks.process_tracks(seen[0])
    with pytest.raises(SlamInitError, match="images after tracks: give an Initializer either images or tracks"):
        of_tracks.process(image)
    of_tracks.process_tracks(seen[1])
    of_images.process(image)
    with pytest.raises(SlamInitError, match="tracks after images"):
        of_images.process_tracks(seen[1])
    of_images.process(image)
    assert (of_tracks.frames_read, of_images.frames_read) == (2, 2)
