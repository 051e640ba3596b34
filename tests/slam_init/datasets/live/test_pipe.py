"""Videos that come through a pipe."""

from __future__ import annotations

import os
import threading
from contextlib import suppress

import cv2
import numpy as np
import pytest
from make_files import picture

from slam_init.datasets.live import read_pipe
from slam_init.datasets.video import open_video
from slam_init.errors import SourceError

GREY = [cv2.cvtColor(picture(seed, (65, 49)), cv2.COLOR_BGR2GRAY) for seed in range(3)]
Y4M = b"YUV4MPEG2 W65 H49 F25:1 Ip A1:1 Cmono\n" + b"".join(b"FRAME\n" + image.tobytes() for image in GREY)
COLOURS = b"YUV4MPEG2 W65 H49 F25:1\n" + b"".join(
    b"FRAME\n" + image.tobytes() + bytes(np.arange(2 * 33 * 25, dtype=np.uint8)) for image in GREY
)
JPEGS = [cv2.imencode(".jpg", image)[1].tobytes() for image in GREY]


def read(data: bytes):
    """All images of a pipe into which these bytes are written."""
    out, into = os.pipe()

    def write():
        with suppress(BrokenPipeError), os.fdopen(into, "wb") as file:
            file.write(data)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        return list(read_pipe("the pipe", out))
    finally:
        os.close(out)
        writer.join()


@pytest.mark.parametrize("data", [Y4M, COLOURS], ids=["grey", "colours"])
def test_a_pipe_gives_the_images_and_times_of_a_file_with_the_same_bytes(data, tmp_path):
    (tmp_path / "video.y4m").write_bytes(data)
    found, expected = read(data), list(open_video(tmp_path / "video.y4m").frames())
    assert [stream_s for _, stream_s in found] == [frame.timestamp_s for frame in expected] == [0.0, 0.04, 0.08]
    for (image, _), frame in zip(found, expected, strict=True):
        np.testing.assert_array_equal(image, frame.image)


def test_jpeg_images_have_no_times():
    found = read(b"".join(JPEGS))
    assert [stream_s for _, stream_s in found] == [None] * 3
    for (image, _), expected in zip(found, JPEGS, strict=True):
        np.testing.assert_allclose(image[..., 0], cv2.imdecode(np.frombuffer(expected, np.uint8), 0), atol=2)


@pytest.mark.parametrize(("data", "count"), [(Y4M[:-10], 2), (JPEGS[0], 1)])
def test_a_pipe_that_ends_early_gives_the_images_before(data, count):
    assert len(read(data)) == count


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "the pipe: cannot be opened: pipe a video into it"),
        (b"garbage" * 1000, "the pipe: cannot be opened"),
        (b"#EXTM3U\n#EXTINF:1\n/etc/passwd\n", "the pipe: cannot be opened"),
        (b"YUV4MPEG2 W20000 H20000\nFRAME\n", "the pipe: cannot be opened"),
        (Y4M + b"NO FRAME\n", "the pipe: ends"),
    ],
)
def test_broken_data_are_refused(data, words):
    with pytest.raises(SourceError, match=words):
        read(data)


def test_a_terminal_is_no_video():
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    try:
        with pytest.raises(SourceError, match="is a terminal: pipe a video"):
            list(read_pipe("standard input", theirs))
    finally:
        os.close(ours)
        os.close(theirs)
