"""Videos that come through a pipe."""

from __future__ import annotations

import os
import threading
from contextlib import suppress

import cv2
import numpy as np
import pytest
from make_files import picture

from slam_init.datasets.live.streams import open_pipe
from slam_init.errors import SourceError

GREY = [cv2.cvtColor(picture(seed, (65, 49)), cv2.COLOR_BGR2GRAY) for seed in range(3)]


def read(data: bytes):
    """All images of a pipe into which these bytes are written."""
    out, into = os.pipe()

    def write():
        with suppress(BrokenPipeError), os.fdopen(into, "wb") as file:
            file.write(data)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        stream = open_pipe("the pipe", out)
        found = []
        while (image := stream.read()) is not None:
            found.append(image)
        return found
    finally:
        os.close(out)
        writer.join()


def y4m(space: str, chroma: int, header: str = "W65 H49 F25:1 Ip A1:1") -> bytes:
    name = f" C{space}" if space else ""
    frames = b"".join(b"FRAME\n" + image.tobytes() + bytes(chroma) for image in GREY)
    return f"YUV4MPEG2 {header}{name} XCOLORRANGE=LIMITED\n".encode() + frames


@pytest.mark.parametrize(
    ("space", "chroma"),
    [("", 2 * 33 * 25), ("420jpeg", 2 * 33 * 25), ("420mpeg2", 2 * 33 * 25), ("422", 2 * 33 * 49), ("444", 2 * 65 * 49),
     ("mono", 0)],
)  # fmt: skip
def test_the_luminance_of_each_colour_space_is_read(space, chroma):
    found = read(y4m(space, chroma))
    assert [image.stream_s for image in found] == [0.0, 0.04, 0.08]
    for image, expected in zip(found, GREY, strict=True):
        np.testing.assert_array_equal(image.image, expected)


def test_a_pipe_that_ends_within_an_image_gives_the_images_before():
    assert len(read(y4m("mono", 0)[:-10])) == 2


@pytest.mark.parametrize("rate", ["", "F0:0", "F1:0", "F99999:1", "Fx"])
def test_a_rate_that_is_impossible_is_not_believed(rate):
    assert [image.stream_s for image in read(y4m("mono", 0, f"W65 H49 {rate}"))] == [None] * 3


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "holds nothing"),
        (b"garbage" * 1000, "neither Y4M nor MJPEG"),
        (b"YUV4MPEG2 " + b"W1 " * 1000, "header has no end"),
        (b"YUV4MPEG2 H3 F1:1\n", "states no width and height"),
        (b"YUV4MPEG2 W-3 H4\n", "states no width and height"),
        (b"YUV4MPEG2 W999999 H999999\n", "states 999999x999999 pixels"),
        (b"YUV4MPEG2 W65 H49 C420p10\n", "colour space '420p10'"),
        (y4m("mono", 0) + b"NO FRAME\n", "image 3 of the Y4M stream does not start with FRAME"),
    ],
)
def test_broken_data_are_refused(data, words):
    with pytest.raises(SourceError, match=words):
        read(data)


def test_a_terminal_is_no_video():
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    try:
        with pytest.raises(SourceError, match="is a terminal: pipe raw video"):
            open_pipe("standard input", theirs)
    finally:
        os.close(ours)
        os.close(theirs)


def jpeg(image: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", image)[1].tobytes()


def test_jpeg_images_are_split_also_where_one_holds_another():
    thumbnail = jpeg(GREY[0][:8, :8])
    segment = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    whole = jpeg(GREY[1])
    found = read(jpeg(GREY[0]) + whole[:2] + segment + whole[2:] + jpeg(GREY[2]))
    assert [image.stream_s for image in found] == [None] * 3
    for image, expected in zip(found, GREY, strict=True):
        np.testing.assert_array_equal(image.image, cv2.imdecode(np.frombuffer(jpeg(expected), np.uint8), 0))


def test_a_jpeg_that_is_cut_off_ends_the_stream():
    assert len(read(jpeg(GREY[0]) + jpeg(GREY[1])[:-50])) == 1


def test_what_follows_a_jpeg_must_be_one():
    with pytest.raises(SourceError, match="image 1 of the MJPEG stream is broken"):
        read(jpeg(GREY[0]) + b"garbage" * 10)
