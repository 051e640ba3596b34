"""What is made of wrong types is refused at once, in one line that names the part and what to give."""

import numpy as np
import pytest

from slam_init import (
    Camera,
    Config,
    Initializer,
    Observations,
    Pose,
    Scale,
    SlamInitError,
    Trajectory,
    export,
    find_scale,
    in_metres,
    load_camera,
    load_config,
    load_graph,
    open_source,
    parse_scale,
    prior_camera,
    pycolmap_reconstruction,
    run,
    write_colmap,
    write_results,
)
from slam_init.types.scale import ScaleOrigin

ONE = np.ones((1, 3))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Camera("pinhole", "a", 48, 60.0, 60.0, 31.5, 23.5), "width of the camera is 'a'"),
        (lambda: Camera("pinhole", 64, 48, None, 60.0, 31.5, 23.5), "fx of the camera is None"),
        (lambda: Camera(["pinhole"], 64, 48, 60.0, 60.0, 31.5, 23.5), "unknown camera model"),
        (lambda: Camera("radtan", 64, 48, 60.0, 60.0, 31.5, 23.5, "0.1"), "give a tuple of numbers"),
        (lambda: Pose(None, np.zeros(3)), "R of a pose has the type NoneType"),
        (
            lambda: Pose(np.eye(4), np.zeros(3)),
            r"R of a pose has the shape \(4, 4\): give an array of the shape \(3, 3\)",
        ),
        (lambda: Pose(np.eye(3), [0.0, 0.0, 0.0]), "t of a pose has the type list"),
        (lambda: Trajectory(1, 2), "the times as an array"),
        (lambda: Trajectory(np.zeros(2), (Pose.identity(),)), "2 times for 1 poses"),
        (lambda: Trajectory(np.zeros(1), (np.eye(4),)), "give a Pose for each time"),
        (lambda: Observations(0, 0.0, "", None, None, None), "track_ids of frame 0 has the type NoneType"),
        (lambda: Observations(0, 0.0, "", np.arange(1), ONE[:, :2], ONE[:, :2]), r"give an array \(1, 3\)"),
        (lambda: Observations(0, 0.0, "", np.arange(2), ONE[:, :2], ONE), r"pixels .* shape \(1, 2\)"),
        (lambda: Config(map=5), "map is of the type int: give a MapConfig"),
        (lambda: open_source(5), "type int: give a path"),
        (lambda: open_source(None), "type NoneType: give a path"),
        (lambda: run("video.mp4"), r"type str: open it by slam_init.open_source"),
    ],
)
def test_a_wrong_type_is_one_line(make, words):
    with pytest.raises(SlamInitError, match=words) as told:
        make()
    assert "\n" not in str(told.value)


def test_numbers_of_numpy_make_a_camera():
    numbers = (np.int64(64), np.int32(48), np.float32(60), np.float64(60), 31.5, np.float16(23.5))
    assert Camera("pinhole", *numbers).fx == 60


A_MAP, A_FOLDER = "the map is of the type", "is of the type .*: give text, or a pathlib.Path"


@pytest.mark.parametrize("wrong", [None, 1.5, [], object()], ids=["None", "number", "list", "object"])
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (load_graph, A_FOLDER),
        (load_camera, A_FOLDER),
        (lambda it: load_config([] if it is None else it), A_FOLDER),
        (lambda it: export(it, "out"), f"{A_MAP} .*: give result.map"),
        (lambda it: write_colmap(it, "out"), A_MAP),
        (pycolmap_reconstruction, A_MAP),
        (lambda it: find_scale(it, parse_scale("height:1")), A_MAP),
        (lambda it: in_metres(it, None), A_MAP),
        (parse_scale, "the scale is of the type .*: give text"),
        (prior_camera, r"give \(width, height\)"),
        (lambda it: write_results("out", it, None), "the result is of the type"),
        (lambda it: run(open_source("synth:room"), start=it or "0"), "start is .*: give an integer from 0 on"),
        (lambda it: run(open_source("synth:room"), continue_frames=it or "9"), "continue_frames is"),
        (lambda it: run(open_source("synth:room"), config=it or "x"), "the configuration is of the type"),
        (lambda it: run(open_source("synth:room"), scale=it or "x"), "the scale is of the type"),
        (lambda it: run(open_source("synth:room"), imu=it or "x"), "imu is of the type"),
        (lambda it: run(open_source("synth:room"), notes=it or "x"), "notes is .*: give a tuple of texts"),
        (lambda it: run(open_source("synth:room"), export=it or "scene"), r"give a list, as in \['scene'\]"),
    ],
)
def test_each_door_refuses_what_it_cannot_take(call, words, wrong, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SlamInitError, match=words) as told:
        call(wrong)
    assert "\n" not in str(told.value)
    assert list(tmp_path.iterdir()) == []


WRONG_IMAGES = [None, "a.png", np.zeros((480, 640)), np.zeros((480, 640, 4), np.uint8), np.zeros((48, 64), np.uint8)]


@pytest.mark.parametrize("image", WRONG_IMAGES, ids=["None", "text", "float", "alpha", "small"])
def test_an_image_that_is_none_of_the_camera_is_refused(image, room_run, tmp_path):
    map_ = room_run.result.map
    images = {keyframe.frame: image for keyframe in map_.keyframes}
    with pytest.raises(SlamInitError, match=r"the image of frame 0 .*: (give uint8, |if they are)"):
        export(map_, tmp_path / "out", ["scene"], images=images)
    with pytest.raises(SlamInitError, match="the image of frame 0"):
        find_scale(map_, parse_scale("marker:tag36h11:0.1"), images=images)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("metres", "sigma"), [(np.nan, 0.1), (0.0, 0.1), (-2.0, 0.1), (np.inf, 0.1), ("2", 0.1), (2.0, -0.1), (2.0, np.nan)]
)
def test_no_map_is_scaled_by_what_is_no_scale(metres, sigma, room_run):
    with pytest.raises(SlamInitError, match=r"the scale has .*: give positive numbers"):
        in_metres(room_run.result.map, Scale(ScaleOrigin.DISTANCE, metres, sigma))


def test_a_null_byte_names_no_folder(room_run):
    with pytest.raises(SlamInitError, match="null byte"):
        room_run.result.map.save("a\0b")


@pytest.mark.parametrize("further", [{"images": [1]}, {"groundtruth": "x"}, {"imu": "x"}, {"located": ["x"]}])
def test_what_tells_the_scale_has_its_type(further, room_run):
    with pytest.raises(SlamInitError, match="is of the type"):
        find_scale(room_run.result.map, parse_scale("distance:1"), **further)


def test_an_initializer_takes_images_or_tracks_and_not_both():
    image = np.random.default_rng(0).integers(0, 256, (48, 64), np.uint8)
    camera = Camera("pinhole", 64, 48, 60.0, 60.0, 31.5, 23.5)
    of_tracks, of_images = Initializer(camera), Initializer(camera)
    pixels = np.array([[10.0, 10.0], [20.0, 30.0]])
    seen = [Observations(k, float(k), "", np.arange(2), pixels, camera.bearings(pixels)) for k in range(3)]
    of_tracks.process_tracks(seen[0])
    with pytest.raises(SlamInitError, match="images after tracks: give an Initializer either images or tracks"):
        of_tracks.process(image)
    of_tracks.process_tracks(seen[1])
    of_images.process(image)
    with pytest.raises(SlamInitError, match="tracks after images"):
        of_images.process_tracks(seen[1])
    of_images.process(image)
    assert (of_tracks.frames_read, of_images.frames_read) == (2, 2)
