"""Bags as sources: images, times, calibrations, topics."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from make_bag import FORMATS, Messages, path_for, small_bag
from make_files import picture

from slam_init.cli import main
from slam_init.datasets import detect_kind, open_source
from slam_init.datasets.image_files import GreyLevels
from slam_init.datasets.views import SourceView
from slam_init.errors import CalibrationError, SourceError
from slam_init.types.camera import Camera

pytest.importorskip("rosbags")

CAMERA = Camera("radtan", 64, 48, 60.0, 61.0, 31.5, 23.5, (0.1, -0.01, 0.001, 0.002))
GREY = [cv2.cvtColor(picture(seed), cv2.COLOR_BGR2GRAY) for seed in range(3)]


@pytest.mark.parametrize("kind", FORMATS)
def test_a_bag_of_each_format_gives_what_was_recorded(tmp_path, kind):
    path = small_bag(kind, GREY, CAMERA).write(path_for(tmp_path, kind))
    source = open_source(path)
    assert source.kind == ("ros1" if kind == "ros1" else "ros2") and len(source) == 3
    frames = list(source.frames())
    assert [frame.index for frame in frames] == [0, 1, 2]
    np.testing.assert_allclose([frame.timestamp_s for frame in frames], [100, 100.1, 100.2])
    np.testing.assert_array_equal(source.timestamps_s, [frame.timestamp_s for frame in frames])
    for frame, image in zip(frames, GREY, strict=True):
        np.testing.assert_array_equal(frame.image, image)
    assert [frame.index for frame in source.frames(1, 1)] == [1]
    assert source.camera == CAMERA
    np.testing.assert_allclose([pose.t[0] for pose in source.groundtruth.world_from_cam], [0, 0.1, 0.2])


@pytest.mark.parametrize("kind", FORMATS[1:])
def test_a_storage_file_of_ros_2_needs_no_metadata(tmp_path, kind):
    folder = small_bag(kind, GREY, CAMERA).write(path_for(tmp_path, kind))
    (folder / "metadata.yaml").unlink()
    (file,) = folder.iterdir()
    assert len(list(open_source(folder).frames())) == len(list(open_source(file).frames())) == 3


@pytest.mark.parametrize("method", ["BZ2", "LZ4"])
def test_compressed_chunks_are_read(tmp_path, method):
    from rosbags.rosbag1 import Writer

    path = small_bag("ros1", GREY, CAMERA).write(tmp_path / "a.bag", compression=[Writer.CompressionFormat[method]])
    np.testing.assert_array_equal(next(open_source(path).frames(2)).image, GREY[2])


@pytest.mark.parametrize(
    ("mode", "kind"), [("MESSAGE", "sqlite3"), ("MESSAGE", "mcap"), ("STORAGE", "mcap"), ("FILE", "sqlite3")]
)
def test_compressed_messages_storages_and_files_of_ros_2_are_read(tmp_path, mode, kind):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode

    path = small_bag(kind, GREY, CAMERA).write(
        tmp_path / "bag", compression=[CompressionMode[mode], CompressionFormat.ZSTD]
    )
    np.testing.assert_array_equal(next(open_source(path).frames(2)).image, GREY[2])


# -- images ----------------------------------------------------------------------------------------


def colour_bag(tmp_path, pixels, encoding, **more):
    messages = Messages("ros1")
    messages.image("/cam/image_raw", 1.0, pixels, encoding, **more)
    return messages.write(tmp_path / "a.bag")


COLOUR = picture(7)
WIDE = np.arange(64 * 48, dtype=np.uint16).reshape(48, 64) * 21


@pytest.mark.parametrize(
    ("encoding", "stored", "more", "expected"),
    [
        ("bgr8", COLOUR, {}, COLOUR),
        ("rgb8", COLOUR[..., ::-1], {}, COLOUR),
        ("bgra8", np.dstack([COLOUR, GREY[0]]), {}, COLOUR),
        ("rgba8", np.dstack([COLOUR[..., ::-1], GREY[0]]), {}, COLOUR),
        ("mono8", GREY[0], {}, GREY[0]),
        ("8UC1", GREY[0], {}, GREY[0]),
        ("mono16", WIDE, {}, GreyLevels.of([WIDE]).reduced(WIDE)),
        ("mono16", WIDE.astype(">u2"), {"is_bigendian": 1}, GreyLevels.of([WIDE]).reduced(WIDE)),
        ("mono8", np.pad(GREY[0], ((0, 0), (0, 16))), {"width": 64}, GREY[0]),
        ("mono8", GREY[0], {"step": 0}, GREY[0]),
    ],
)
def test_each_encoding_gives_the_same_picture(tmp_path, encoding, stored, more, expected):
    source = open_source(colour_bag(tmp_path, stored, encoding, **more))
    np.testing.assert_array_equal(next(source.frames()).image, expected)


@pytest.mark.parametrize(("mosaic", "places"), [("rggb", "RGGB"), ("bggr", "BGGR"), ("gbrg", "GBRG"), ("grbg", "GRBG")])
@pytest.mark.parametrize("bits", [8, 16])
def test_a_mosaic_of_one_colour_is_that_colour(tmp_path, mosaic, places, bits):
    bgr = {"B": 40, "G": 120, "R": 200}
    cell = np.array([bgr[place] for place in places]).reshape(2, 2)
    pixels = np.tile(cell, (24, 32)).astype(np.uint8)
    stored = pixels if bits == 8 else pixels.astype(np.uint16) << 8
    found = next(open_source(colour_bag(tmp_path, stored, f"bayer_{mosaic}{bits}")).frames()).image
    # The grey levels of 16 bits are stretched.
    expected = np.array([40, 120, 200]) if bits == 8 else np.round(np.interp([40, 120, 200], [0, 240], [0, 255]))
    assert (found[2:-2, 2:-2] == expected).all()


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_compressed_images_are_decoded(tmp_path, suffix):
    messages = Messages("mcap")
    _, data = cv2.imencode(suffix, COLOUR)
    messages.compressed("/cam/image_raw/compressed", 1.0, data.tobytes(), "bgr8; jpeg compressed bgr8")
    found = next(open_source(messages.write(tmp_path / "bag")).frames()).image
    np.testing.assert_array_equal(found, cv2.imdecode(data, cv2.IMREAD_COLOR))


@pytest.mark.parametrize(
    ("encoding", "more", "words"),
    [
        ("strange8", {}, "'strange8' is not supported: use one of mono8"),
        ("mono8", {"height": 49}, "hold no 64x49 pixels"),
        ("bgr8", {}, "hold no 64x48 pixels"),
        ("mono8", {"width": 2**31, "height": 2**31}, "at most 134 million"),
        ("mono8", {"width": 0}, "0x48 pixels"),
    ],
)
def test_an_image_that_cannot_be_decoded_is_refused_by_name(tmp_path, encoding, more, words):
    with pytest.raises(SourceError, match=words) as caught:
        open_source(colour_bag(tmp_path, GREY[0], encoding, **more))
    assert "/cam/image_raw, message 0" in str(caught.value)


# -- times -----------------------------------------------------------------------------------------


def test_images_without_stamps_have_the_times_of_the_recording(tmp_path):
    messages = Messages("sqlite3")
    for time_s in (5.0, 5.5):
        messages.image("/cam/image_raw", time_s, GREY[0], "mono8", stamp_s=0.0)
    source = open_source(messages.write(tmp_path / "bag"))
    assert [frame.timestamp_s for frame in source.frames()] == [5.0, 5.5]
    assert any("recorded" in note for note in source.notes)


def late_bag(tmp_path, *stamps_s):
    """A bag of images that are recorded from 5 s on at 10 Hz, with these stamps."""
    messages = Messages("ros1")
    for k, stamp_s in enumerate(stamps_s):
        messages.image("/cam/image_raw", 5 + k / 10, GREY[0], "mono8", stamp_s=stamp_s)
    return messages.write(tmp_path / "a.bag")


def test_images_that_come_too_late_are_left_out_and_counted(tmp_path):
    source = open_source(late_bag(tmp_path, 5.0, 4.9, 5.0, 5.3))
    assert [(frame.index, frame.timestamp_s) for frame in source.frames()] == [(0, 5.0), (1, 5.3)]
    assert [frame.timestamp_s for frame in source.frames(1)] == [5.3]
    assert any(note.startswith("2 images") for note in source.notes)


@pytest.mark.parametrize("view", [SourceView(every=1), SourceView(fps=20.0), SourceView(every=2)])
def test_a_bag_with_late_images_is_thinned_by_the_frames_that_it_gives(tmp_path, view):
    path = late_bag(tmp_path, 5.0, 4.9, 5.2, 5.3, 5.4)
    expected = [5.0, 5.3] if view.every == 2 else [5.0, 5.2, 5.3, 5.4]
    for renumbered in (False, True):
        source = view.apply(open_source(path), renumbered=renumbered)
        assert [frame.timestamp_s for frame in source.frames()] == expected == source.timestamps_s.tolist()


def test_images_that_the_index_names_and_the_bag_lacks_are_reported(tmp_path):
    messages = Messages("mcap")
    for time_s in (5.0, 5.1, 5.2):
        messages.image("/cam/image_raw", time_s, GREY[0], "mono8")
    folder = messages.write(tmp_path / "bag")
    (file,) = folder.glob("*.mcap")
    data = bytearray(file.read_bytes())
    pixels = GREY[0].tobytes()
    end = data.index(pixels, data.index(pixels) + 1) + len(pixels)
    # A record is its kind, its length and its content; the message becomes a record of an unknown kind.
    (begin,) = (k for k in range(end) if data[k] == 5 and k + 9 + int.from_bytes(data[k + 1 : k + 9], "little") == end)
    data[begin] = 0x99
    file.write_bytes(data)
    source = open_source(folder)
    assert source.timestamps_s.tolist() == [5.0, 5.2] == [frame.timestamp_s for frame in source.frames()]
    assert any("names 3 images" in note and "2 can be read" in note for note in source.notes)


# -- topics ----------------------------------------------------------------------------------------


def two_cameras(tmp_path):
    messages = Messages("mcap")
    for k, name in enumerate(("/left/image_raw", "/right/image_raw")):
        messages.image(name, 1.0, GREY[k], "mono8")
    return messages.write(tmp_path / "bag")


def test_several_cameras_are_listed_and_one_is_chosen(tmp_path, capsys):
    path = two_cameras(tmp_path)
    with pytest.raises(SourceError, match="--topic /left/image_raw or /right/image_raw"):
        open_source(path)
    with pytest.raises(SourceError, match="no images in the topic '/top'"):
        open_source(f"{path}?topic=/top")
    assert detect_kind(f"{path}?topic=/right/image_raw") == "ros2"
    np.testing.assert_array_equal(next(open_source(f"{path}?topic=right/image_raw").frames()).image, GREY[1])
    assert main(["info", str(path), "--topic", "/right/image_raw"]) == 0
    assert "bag (ros2)" in capsys.readouterr().out
    assert main(["info", str(tmp_path / "none.bag"), "--topic", "/right/image_raw"]) == 2
    assert "no such file or folder" in capsys.readouterr().err


def test_a_camera_that_is_recorded_twice_and_a_depth_image_need_no_choice(tmp_path):
    messages = Messages("ros1")
    messages.image("/depth/image", 1.0, WIDE, "16UC1")
    messages.image("/cam/image_raw", 1.0, GREY[0], "mono8")
    messages.compressed("/cam/image_raw/compressed", 1.0, cv2.imencode(".png", GREY[0])[1].tobytes(), "png")
    messages.compressed("/depth/image/compressedDepth", 1.0, b"abc", "16UC1; compressedDepth png")
    source = open_source(messages.write(tmp_path / "a.bag"))
    assert source.topic.name == "/cam/image_raw"
    assert any("/cam/image_raw/compressed" in note for note in source.notes)


def test_a_bag_without_images_lists_what_it_holds(tmp_path):
    messages = Messages("ros1")
    messages.camera_info("/cam/camera_info", 1.0, CAMERA)
    with pytest.raises(SourceError, match="but /cam/camera_info"):
        open_source(messages.write(tmp_path / "a.bag"))


def test_a_path_that_holds_a_question_mark_is_no_choice_of_topics(tmp_path):
    path = small_bag("ros1", GREY, CAMERA).write(tmp_path / "a.bag?topic=x")
    assert len(open_source(path)) == 3
    with pytest.raises(SourceError, match="no such file"):
        open_source(f"{tmp_path}/none.bag?topic=/a")
    (tmp_path / "video.avi").write_bytes(b"\x00garbage")
    with pytest.raises(SourceError, match="no ROS bag"):
        open_source(f"{tmp_path}/video.avi?topic=/a")


# -- calibration -----------------------------------------------------------------------------------


def info_bag(tmp_path, topic="/cam/image_raw", info="/cam/camera_info", camera=CAMERA, **more):
    messages = Messages("sqlite3")
    messages.image(topic, 1.0, GREY[0], "mono8")
    messages.camera_info(info, 1.0, camera, **more)
    return open_source(messages.write(tmp_path / "bag"))


FISHEYE = Camera("fisheye", 64, 48, 30.0, 30.0, 31.5, 23.5, (0.01, 0.002, 0.0, 0.0))
RATIONAL = {"model": "rational_polynomial", "d": np.array([*CAMERA.distortion, 0, 0, 0, 0.0])}
P = np.array([50.0, 0, 30, 0, 0, 51, 20, 0, 0, 0, 1, 0])


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ({"camera": FISHEYE, "model": "equidistant"}, FISHEYE),
        (RATIONAL, CAMERA),
        ({"topic": "/cam/image_rect", "p": P}, Camera("pinhole", 64, 48, 50.0, 51.0, 30.0, 20.0)),
        ({"info": "/elsewhere/info"}, CAMERA),  # found by its frame
        ({"info": "/elsewhere/info", "frame": "other"}, None),
        ({"k": np.zeros(9)}, None),  # not calibrated
    ],
)
def test_the_calibration_is_that_of_the_topic_or_of_its_frame(tmp_path, stated, expected):
    assert info_bag(tmp_path, **stated).camera == expected


def test_a_calibration_of_other_images_is_refused_when_it_is_used(tmp_path):
    source = info_bag(tmp_path, camera=Camera("pinhole", 640, 480, 500.0, 500.0, 320.0, 240.0))
    assert next(source.frames()).image.shape == (48, 64)
    with pytest.raises(CalibrationError, match=r"/cam/camera_info: calibration is for 640x480"):
        _ = source.camera
