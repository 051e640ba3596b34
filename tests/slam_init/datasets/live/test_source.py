"""Live sources: the queue, times, how they end, and videos that come through a pipe."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress

import cv2
import numpy as np
import pytest
from make_files import picture

from slam_init.config import Config
from slam_init.datasets import open_source
from slam_init.datasets.live import (
    QUEUE_FRAMES,
    LiveSource,
    StreamImage,
    is_live,
    open_live,
    read_pipe,
    without_password,
)
from slam_init.datasets.video import open_video
from slam_init.errors import SourceError
from slam_init.runner import run
from slam_init.types.camera import Camera
from slam_init.types.frame import length_of

CAMERA = Camera("pinhole", 64, 48, 60.0, 60.0, 31.5, 23.5)


def images(count: int, stated: Callable[[int], float | None] = lambda k: None) -> list[StreamImage]:
    return [(np.full((48, 64), k, np.uint8), stated(k)) for k in range(count)]


def endless(given: list[StreamImage]) -> Iterator[StreamImage]:
    """Images, and then none for ever."""
    yield from given
    threading.Event().wait()


def lost(given: list[StreamImage]) -> Iterator[StreamImage]:
    yield from given
    raise SourceError("test: no more images")


def paused(before: int, begun: threading.Event, after: int, taken: threading.Event) -> Iterator[StreamImage]:
    """Images, and more of them when the processing has begun."""
    yield from images(before)
    begun.wait()
    yield from images(after)
    taken.set()


def numbers(frames) -> list[int]:
    return [int(frame.image[0, 0]) for frame in frames]


def test_the_frames_of_a_stream_come_in_order_and_have_no_length():
    with LiveSource("test", lambda: iter(images(5, lambda k: k / 2)), keep_all=True) as source:
        assert length_of(source) is None and length_of(open_source("synth:room?frames=3")) == 3
        frames = list(source.frames())
    assert numbers(frames) == [frame.index for frame in frames] == list(range(5))
    np.testing.assert_allclose(np.diff([frame.timestamp_s for frame in frames]), 0.5, atol=1e-6)
    assert (source.kind, source.camera, source.groundtruth, source.notes) == ("live", None, None, ())


def test_a_frame_that_was_looked_at_is_not_lost():
    with LiveSource("test", lambda: iter(images(5)), keep_all=True) as source:
        assert numbers(source.frames(2, 1)) == [2]
        assert numbers(source.frames(2)) == [2, 3, 4]


def test_the_oldest_frames_are_dropped_and_counted():
    begun, taken = threading.Event(), threading.Event()
    with LiveSource("test", lambda: paused(2, begun, 100, taken)) as source:
        frames = source.frames()
        first = [next(frames), next(frames)]
        begun.set()
        assert taken.wait(10)
        last = list(frames)
    assert numbers(first) == [0, 1]
    assert len(last) == QUEUE_FRAMES and numbers(last)[-1] == 99
    assert source.dropped == 102 - len(first) - len(last)
    assert f"{source.dropped} of 102 frames were dropped" in source.notes[0]
    assert last[-1].index == 101, "dropped frames leave gaps in the numbers"


def test_what_is_dropped_before_the_processing_begins_does_not_count():
    begun, taken = threading.Event(), threading.Event()
    with LiveSource("test", lambda: paused(1, begun, 50, taken)) as source:
        assert len(list(source.frames(0, 1))) == 1
        begun.set()
        assert taken.wait(10)
        frames = list(source.frames())
    assert len(frames) == QUEUE_FRAMES and numbers(frames)[-1] == 49, "what was looked at is too old"
    assert source.dropped == 0


def test_a_sender_that_is_to_wait_loses_no_frame():
    with LiveSource("test", lambda: iter(images(50)), keep_all=True) as source:
        frames = list(source.frames())
    assert numbers(frames) == list(range(50)) and source.dropped == 0
    np.testing.assert_allclose(np.diff([frame.timestamp_s for frame in frames]), 1 / 30, atol=1e-6)
    assert any("30 frames a second are assumed" in note for note in source.notes)


@pytest.mark.parametrize("stated", [lambda k: None, lambda k: 3.0, lambda k: k if k < 2 else None])
def test_times_increase_also_where_those_of_the_stream_do_not(stated):
    with LiveSource("test", lambda: iter(images(8, stated))) as source:
        frames = list(source.frames())
    assert (np.diff([frame.timestamp_s for frame in frames]) > 0).all()
    message = ("the times of the stream do not increase: times of arrival are taken",) if stated(7) else ()
    assert source.notes == message


# -- the end ---------------------------------------------------------------------------------------


def test_a_source_that_cannot_be_opened_is_refused():
    with LiveSource("test", lambda: lost([])) as source, pytest.raises(SourceError, match="no more images"):
        next(source.frames())


def test_a_lost_stream_ends_the_source_with_a_note():
    with LiveSource("test", lambda: lost(images(3)), keep_all=True) as source:
        assert numbers(source.frames()) == [0, 1, 2]
    assert source.notes[-1] == "the source ended: test: no more images"


def test_an_image_of_another_size_ends_the_source_with_a_note():
    given = [*images(2), (np.zeros((10, 10), np.uint8), None)]
    with LiveSource("test", lambda: iter(given), keep_all=True) as source:
        assert numbers(source.frames()) == [0, 1]
    assert any("image 2 is 10x10" in note for note in source.notes)


def test_an_error_of_the_program_is_no_end():
    def broken():
        raise ZeroDivisionError

    with LiveSource("test", broken) as source, pytest.raises(ZeroDivisionError):
        next(source.frames())


def test_a_stopped_source_ends_the_run_as_if_its_data_had_ended(tmp_path):
    class Stopped(LiveSource):
        """Is stopped when its third frame is processed, as by an interrupt."""

        def frames(self, start=0, max_frames=None):
            for frame in super().frames(start, max_frames):
                yield frame
                if frame.index == 2:
                    self.stop()

    with Stopped("test", lambda: endless(images(3)), keep_all=True) as source:
        result, summary = run(source, CAMERA, Config(), out=tmp_path / "out", max_frames=10)
    assert result.frames_read == 3 and summary.source.kind == "live"
    assert "the source was stopped by the user" in summary.notes
    assert (tmp_path / "out" / "summary.json").is_file() and (tmp_path / "out" / "recording.rrd").is_file()


# -- names -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["-", "camera:0", "rtsp://host/path", "http://host:80/a.ts", "HTTPS://host"])
def test_live_names(text):
    assert is_live(text)
    with pytest.raises(SourceError, match="live source"):
        open_source(text)


@pytest.mark.parametrize("text", ["a.mp4", "folder", "synth:room", "http:", "ftp://host", "rtsp:///path", "--"])
def test_other_names(text):
    assert not is_live(text)


@pytest.mark.parametrize("text", ["camera:", "camera:x", "camera:-1", "camera:12345"])
def test_a_camera_has_a_number(text):
    with pytest.raises(SourceError, match="number of a camera"):
        open_live(text)


def test_a_password_is_not_reported():
    assert open_live("rtsp://me:secret@host/path").name == "rtsp://host/path"
    assert without_password("--out a@b http://u:p@h/x") == "--out a@b http://h/x"


# -- pipes -----------------------------------------------------------------------------------------


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
