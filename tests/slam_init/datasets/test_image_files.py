"""Image files: pixels as stored, 16 bits, equal sizes, a video or photographs; broken files refused by name."""

import struct
import zlib
from itertools import pairwise

import cv2
import numpy as np
import pytest
from make_files import picture, write, write_image
from PIL import Image

from slam_init.datasets import open_source
from slam_init.datasets.image_files import IMAGE_SUFFIXES, GreyLevels, read_image
from slam_init.errors import SourceError


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (picture(channels=4), picture(channels=4)[..., :3]),
        (257 * picture(channels=1).astype(np.uint16), picture(channels=1)),
        (257 * picture(channels=3).astype(np.uint16), picture(channels=3)),
        (picture(channels=1), picture(channels=1)),
    ],
)
def test_images_are_reduced_to_8_bits_without_transparency(tmp_path, image, expected):
    write_image(tmp_path / "a.png", image)
    result = read_image(tmp_path / "a.png")
    np.testing.assert_array_equal(result, expected)
    assert result.dtype == np.uint8 and result.flags.c_contiguous


def test_a_jpeg_of_four_inks_is_read_as_colours(tmp_path):
    image = pytest.importorskip("PIL.Image")
    image.fromarray(picture(channels=4), "CMYK").save(tmp_path / "a.jpg")
    assert read_image(tmp_path / "a.jpg").shape == (48, 64, 3)


def test_the_exif_orientation_is_not_applied(tmp_path):
    write_image(tmp_path / "a.jpg", picture(size=(64, 48)))
    data = (tmp_path / "a.jpg").read_bytes()
    # Orientation (0x0112) = 6: "turn by 90 degrees", in a little-endian TIFF header of one entry.
    tiff = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    exif = b"Exif\0\0" + tiff
    write(tmp_path / "a.jpg", data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:])
    # OpenCV applies this orientation by default.
    assert cv2.imread(str(tmp_path / "a.jpg")).shape[:2] == (64, 48)
    assert read_image(tmp_path / "a.jpg").shape[:2] == (48, 64)


def png_that_states(width, height):
    """The bytes of a tiny PNG whose header, with a right checksum, states this size."""
    data = bytearray(cv2.imencode(".png", picture())[1].tobytes())
    data[16:24] = struct.pack(">II", width, height)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return bytes(data)


def test_an_image_is_refused_by_the_size_that_its_header_states(tmp_path):
    write(tmp_path / "a.png", png_that_states(100_000, 100_000))
    with pytest.raises(SourceError, match=r"a.png.*134 million"):
        read_image(tmp_path / "a.png")
    write(tmp_path / "a.png", png_that_states(64, 48))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), picture())


@pytest.mark.parametrize("suffix", sorted(IMAGE_SUFFIXES - {".jpeg", ".tiff"}))
def test_the_header_of_each_format_is_understood(tmp_path, suffix):
    write_image(tmp_path / f"a{suffix}", picture(channels=1 if suffix == ".pgm" else 3))
    assert read_image(tmp_path / f"a{suffix}").shape[:2] == (48, 64)


def test_links_that_leave_the_folder_are_not_followed_and_others_are(tmp_path):
    data, outside = tmp_path / "data", tmp_path / "outside"
    write_image(data / "a.png", picture(1))
    write_image(outside / "b.png", picture(2))
    (data / "b.png").symlink_to(data / "a.png")
    (tmp_path / "link").symlink_to(data)
    assert len(list(open_source(str(tmp_path / "link")).frames())) == 2
    (data / "c.png").symlink_to(outside / "b.png")
    with pytest.raises(SourceError, match=r"c\.png: leads out of the folder"):
        list(open_source(str(data)).frames())


def unreadable_images():
    jpeg = cv2.imencode(".jpg", picture(size=(320, 240)))[1].tobytes()
    png = cv2.imencode(".png", picture(size=(320, 240)))[1].tobytes()
    return {
        "empty.png": b"",
        "garbage.png": b"no image at all",
        "cut.jpg": jpeg[: len(jpeg) // 2],
        "cut.png": png[:100],
        "chunk of 4 GB.png": png[:33] + b"\xff" * 4 + png[37:],
        "float.tiff": cv2.imencode(".tiff", np.ones((8, 8), np.float32))[1].tobytes(),
    }


@pytest.mark.parametrize("name", unreadable_images())
def test_an_unreadable_image_is_refused_by_name_when_it_is_read(tmp_path, name):
    write_image(tmp_path / "a.png", picture(size=(320, 240)))
    write(tmp_path / f"b_{name}", unreadable_images()[name])
    frames = open_source(str(tmp_path)).frames()
    assert next(frames).index == 0
    with pytest.raises(SourceError, match=f"b_{name}"):
        next(frames)


def test_images_of_two_sizes_are_refused(tmp_path):
    write_image(tmp_path / "a.png", picture(size=(64, 48)))
    write_image(tmp_path / "b.png", picture(size=(48, 64)))
    with pytest.raises(SourceError, match=r"b.png.*48x64.*64x48"):
        list(open_source(str(tmp_path)).frames())


# -- grey levels of 16 bits ------------------------------------------------------------------------


RAMP = np.linspace(0.0, 1.0, 48 * 64).reshape(48, 64)


def test_two_thirds_of_the_levels_are_kept_wherever_the_range_lies():
    for low, span in ((0, 4095), (7300, 820), (0, 65535), (64000, 1500), (40, 60), (100, 255), (30000, 3)):
        image = np.round(low + span * RAMP).astype(np.uint16)
        image[0, 0], image[-1, -1] = 0, 65535  # a dead pixel and a hot one
        reduced = GreyLevels.of([image]).reduced(image)
        order = np.argsort(image, axis=None, kind="stable")
        assert reduced.dtype == np.uint8 and (np.diff(reduced.ravel()[order].astype(int)) >= 0).all()
        assert len(np.unique(reduced)) >= 0.6 * min(span, 255)
        # A step of one level of the image is never more than one level.
        steps = np.diff(np.unique(GreyLevels.of([image]).reduced(np.arange(low, low + span, dtype=np.uint16))))
        assert not len(steps) or steps.max() <= 1


def test_images_outside_of_the_range_become_black_and_white_and_8_bits_stay():
    levels = GreyLevels.of([np.round(7300 + 800 * RAMP).astype(np.uint16)])
    assert levels.reduced(np.array([[0, 5000, 60000, 65535]], np.uint16)).tolist() == [[0, 0, 255, 255]]
    grey = np.arange(256, dtype=np.uint8).reshape(16, 16)
    assert levels.reduced(grey) is grey
    assert GreyLevels.of([grey]) == GreyLevels.of([np.zeros((4, 4), np.uint16)]) == GreyLevels()


def test_all_images_of_a_folder_have_one_range_and_a_note_states_it(tmp_path):
    """The scene becomes warmer. Wherever a run begins, in a plain folder or a list, an image is the same."""
    for k in range(20):
        write_image(tmp_path / "images" / f"{k}.png", np.round(7000 + 30 * k + 800 * RAMP).astype(np.uint16))
    plain = open_source(tmp_path)
    frames = [frame.image for frame in plain.frames()]
    assert sum("16 bits" in note for note in plain.notes) == 1
    assert all(np.mean(before) < np.mean(after) for before, after in pairwise(frames))
    assert all(len(np.unique(image)) > 80 and image.max() < 255 for image in frames)
    write(tmp_path / "rgb.txt", "".join(f"{k / 30} images/{k}.png\n" for k in range(20)))
    for source in (plain, open_source(tmp_path)):
        np.testing.assert_array_equal(next(source.frames(13)).image, frames[13])
    write_image(tmp_path / "grey" / "a.png", cv2.imread(str(tmp_path / "images" / "0.png")))
    grey = open_source(tmp_path / "grey")
    assert next(grey.frames()).image.dtype == np.uint8 and not any("16 bits" in note for note in grey.notes)


# -- a video or photographs ------------------------------------------------------------------------


TEXTURE = cv2.GaussianBlur(picture(0, (1200, 300), 1), (0, 0), 3)


def views(lefts):
    """What a camera of 320 x 240 pixels sees of a wall, with its left side at these columns."""
    return [np.ascontiguousarray(TEXTURE[20:260, left : left + 320]) for left in lefts]


@pytest.mark.parametrize(
    ("lefts", "rate_hz"),
    [
        (range(0, 160, 8), 30),  # even and small
        ([0] * 8, 30),  # a static camera
        (np.cumsum([0, 4, 5, 7, 8, 8, 7, 5, 3]), 30),  # a hand that swings
        (range(0, 800, 80), 1),  # a panorama: even and large
        (np.cumsum([0, 5, 40, 12, 60, 3, 33, 20, 70]), 1),
        ([0, 40, 45], 1),
        ([0, 8], 1),  # no step follows another one
        ([0], 1),
    ],
)
def test_the_steps_distinguish_a_video_from_photographs(tmp_path, lefts, rate_hz):
    for k, view in enumerate(views(lefts)):
        write_image(tmp_path / f"{k}.png", view)
    source = open_source(tmp_path)
    np.testing.assert_allclose(source.timestamps_s, np.arange(len(lefts)) / rate_hz)
    (note,) = source.notes
    assert ("as a video of 30 frames a second" if rate_hz == 30 else "as photographs") in note


def test_images_that_name_their_camera_are_photographs(tmp_path):
    exif = Image.Exif()
    exif[0x0110] = "phone"
    for k, view in enumerate(views(range(0, 80, 8))):
        Image.fromarray(view).save(tmp_path / f"{k}.jpg", exif=exif)
    assert open_source(tmp_path).timestamps_s[1] == 1
