"""Image files: pixels as stored, broken files refused by name, equal sizes."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from make_files import picture, write, write_image

from slam_init.datasets import open_source
from slam_init.datasets.image_files import IMAGE_SUFFIXES, read_image
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
