"""Video files."""

import cv2
import numpy as np
import pytest
from make_files import write
from path_types import PATH_TYPES

from slam_init.datasets import open_source
from slam_init.datasets.video import open_video
from slam_init.errors import SourceError


@pytest.fixture
def video(tmp_path):
    path = tmp_path / "a video é.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for i in range(7):
        writer.write(np.full((48, 64, 3), 30 * i, np.uint8))
    writer.release()
    return path


def test_frames_and_times_of_a_video_are_read(video):
    source = open_source(str(video))
    assert (source.kind, len(source), source.camera, source.groundtruth) == ("video", 7, None, None)
    frames = list(source.frames(5))
    assert [(f.index, f.timestamp_s, f.name) for f in frames] == [
        (5, 0.25, "frame-000005"),
        (6, 0.3, "frame-000006"),
    ]
    assert abs(frames[0].image.mean() - 150) < 3


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_open_video_takes_every_type_of_path(video, path_type):
    assert len(open_video(path_type(video))) == 7


def test_a_length_or_rate_that_is_impossible_is_not_believed(video):
    data = bytearray(video.read_bytes())
    header, stream = data.index(b"avih") + 8, data.index(b"strh") + 8
    data[header + 16 : header + 20] = data[stream + 32 : stream + 36] = (2**31 - 1).to_bytes(4, "little")
    index = data.rindex(b"idx1")
    write(video, bytes(data[:index]))
    source = open_source(str(video))
    assert len(source) <= 7 == len(list(source.frames()))
    assert source.timestamps_s.shape == (len(source),)


@pytest.mark.parametrize("text", ["#EXTM3U\n/etc/hostname\n", "ffconcat version 1.0\nfile other.avi\n", "v=0\r\n"])
def test_a_playlist_is_no_video(tmp_path, text):
    write(tmp_path / "v.avi", text)
    with pytest.raises(SourceError, match=r"v\.avi: is a text"):
        open_source(str(tmp_path / "v.avi"))


@pytest.mark.parametrize("data", [b"", b"garbage" * 100, b"RIFF\0\0\0\0AVI LIST"])
def test_a_broken_video_is_refused_by_name(tmp_path, data):
    write(tmp_path / "v.avi", data)
    with pytest.raises(SourceError, match=r"v\.avi"):
        open_source(str(tmp_path / "v.avi"))
