"""Cameras and network streams. A capture of a file stands for a device; servers are real where they are installed."""

from __future__ import annotations

import shutil
import socket
import subprocess
import time
from contextlib import contextmanager

import cv2
import numpy as np
import pytest
from make_video import write_grey

from slam_init.datasets.live import open_live
from slam_init.errors import SourceError

pytestmark = pytest.mark.process


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Twenty images at 30 Hz; image k has the grey value 10 k."""
    return write_grey(tmp_path_factory.mktemp("video") / "video.avi", range(0, 200, 10), 30.0)


@contextmanager
def started(*command: str):
    """A process that is ended at the end."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def test_a_capture_stands_for_a_camera(video, monkeypatch):
    capture = cv2.VideoCapture(str(video))
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: capture)
    with open_live("camera:0", keep_all=True) as source:
        frames = list(source.frames())
    assert [round(frame.image.mean() / 10) for frame in frames] == list(range(20))
    assert source.notes[-1] == "the source ended: camera:0: no more images"


def test_a_camera_that_is_not_there_is_refused_by_name():
    with open_live("camera:99") as source, pytest.raises(SourceError, match="camera:99: cannot be opened"):
        next(source.frames())


def test_an_address_that_nobody_answers_is_refused_by_name():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}/video"
    with open_live(f"http://me:secret@{address}") as source, pytest.raises(SourceError) as caught:
        next(source.frames())
    assert str(caught.value).startswith(f"http://{address}: cannot be opened")


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg (Debian: ffmpeg)")
def test_a_stream_over_http_is_received(video):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}/video.ts"
    coded = ("-c:v", "mpeg2video", "-q:v", "2", "-f", "mpegts")
    with started("ffmpeg", "-loglevel", "error", "-i", str(video), *coded, "-listen", "1", url):
        for _ in range(100):  # the server does not report that it listens
            try:
                with open_live(url, keep_all=True) as source:
                    frames = list(source.frames())
                break
            except SourceError:
                time.sleep(0.1)
        else:
            pytest.skip("ffmpeg did not start in time")
    assert len(frames) >= 18
    assert [round(frame.image.mean() / 10) for frame in frames] == [frame.index for frame in frames]
    np.testing.assert_allclose(np.diff([frame.timestamp_s for frame in frames]), 1 / 30, atol=2e-5)
