"""Video files. Interlaced frames are found by their comb, and replaced by one field."""

from contextlib import contextmanager
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from make_files import picture, write
from make_scene import texture
from make_video import corner_frames, write_by_pyav, write_grey, write_mp4

from slam_init.datasets import open_source
from slam_init.datasets import video as video_reader
from slam_init.datasets.video import comb_ratio, first_field, open_video
from slam_init.errors import SourceError


@pytest.fixture
def video(tmp_path):
    return write_grey(tmp_path / "a video é.avi", range(0, 210, 30), 20.0)


def test_frames_and_times_of_a_video_are_read(video):
    source = open_source(str(video))
    assert (source.kind, len(source), source.camera, source.groundtruth) == ("video", 7, None, None)
    frames = list(source.frames(5))
    assert [(f.index, f.timestamp_s, f.name) for f in frames] == [(5, 0.25, "frame-000005"), (6, 0.3, "frame-000006")]
    assert abs(frames[0].image.mean() - 150) < 3


@pytest.mark.parametrize("name", ["a%03d.avi", "100%.avi", "#1?.avi"])
def test_a_name_that_is_a_pattern_elsewhere_is_a_name(video, name):
    assert len(list(open_source(str(video.rename(video.with_name(name)))).frames())) == 7


def test_a_length_or_rate_that_is_impossible_is_not_believed(video):
    data = bytearray(video.read_bytes())
    header, stream = data.index(b"avih") + 8, data.index(b"strh") + 8
    data[header + 16 : header + 20] = data[stream + 32 : stream + 36] = (2**31 - 1).to_bytes(4, "little")
    index = data.rindex(b"idx1")
    write(video, bytes(data[:index]))
    source = open_source(str(video))
    assert len(source) <= 7 == len(list(source.frames()))
    assert source.timestamps_s.shape == (len(source),)


PLAYLISTS = ("#EXTM3U\n/etc/hostname\n", "ffconcat version 1.0\nfile other.avi\n", "v=0\r\n")


@pytest.mark.parametrize("data", [*PLAYLISTS, b"", b"garbage" * 100, b"RIFF\0\0\0\0AVI LIST"])
def test_a_playlist_and_a_broken_video_are_refused_by_name(tmp_path, data):
    with pytest.raises(SourceError, match=r"v\.avi: is a text" if data in PLAYLISTS else r"v\.avi"):
        open_source(write(tmp_path / "v.avi", data))


@pytest.mark.parametrize(("turned_deg", "bright"), [(0, (0, 0)), (90, (0, 1)), (180, (1, 1)), (270, (1, 0))])
def test_the_frames_of_a_turned_video_come_upright(tmp_path, turned_deg, bright):
    """The bright corner moves clockwise, and width and height change places."""
    source = open_video(write_mp4(tmp_path / "v.mp4", corner_frames(), turned_deg=turned_deg))
    frames = list(source.frames())
    height, width = (64, 48) if turned_deg % 180 else (48, 64)
    assert len(frames) == 6 and source.size == (width, height)
    for frame in frames:
        assert frame.image.shape == (height, width, 3)
        quarters = cv2.resize(frame.gray, (2, 2), interpolation=cv2.INTER_AREA)
        assert np.unravel_index(np.argmax(quarters), (2, 2)) == bright
    assert any(f"turned by {turned_deg} degrees" in note for note in source.notes) == bool(turned_deg)


def test_the_times_of_a_variable_frame_rate_are_those_of_the_container(tmp_path):
    times_ms = [0, 33, 70, 100, 250, 283]
    source = open_video(write_by_pyav(tmp_path / "v.mp4", corner_frames(), times_ms=times_ms))
    expected = [0.001 * ms for ms in times_ms]
    assert [frame.timestamp_s for frame in source.frames()] == pytest.approx(expected)
    assert source.timestamps_s == pytest.approx(expected)
    assert [(f.index, f.timestamp_s) for f in source.frames(3, 2)] == [
        (3, pytest.approx(0.1)),
        (4, pytest.approx(0.25)),
    ]


@pytest.mark.parametrize(
    ("codec", "pixels"), [("libx265", "yuv420p10le"), ("libx264", "yuv420p"), ("libsvtav1", "yuv420p")]
)
def test_the_codecs_of_phones_are_read(tmp_path, codec, pixels):
    frames = corner_frames(4, (128, 96))
    options = {"x265-params": "log-level=none"} if codec == "libx265" else {"preset": "12"} if "av1" in codec else {}
    path = write_by_pyav(tmp_path / "v.mp4", frames, codec=codec, pixels=pixels, options=options)
    source = open_video(path)
    seen = list(source.frames())
    assert len(seen) == 4 == len(source.timestamps_s)
    for frame, image in zip(seen, frames, strict=True):
        assert abs(frame.image.astype(float) - image).mean() < 8
    assert (np.diff(source.timestamps_s) > 0).all()


def test_a_stream_without_a_decoder_is_one_line(tmp_path, monkeypatch):
    @contextmanager
    def opened(path):
        yield None, SimpleNamespace(codec_context=None)

    monkeypatch.setattr(video_reader, "_opened", opened)
    with pytest.raises(SourceError, match="no installed decoder knows the codec"):
        open_video(write_mp4(tmp_path / "v.mp4", corner_frames()))


# -- interlaced frames -----------------------------------------------------------------------------


TEXTURE = texture(3, 200, 300)


def shifted(pixels: int) -> np.ndarray:
    return TEXTURE[20:160, 20 + pixels : 260 + pixels]


def woven(pixels: int) -> np.ndarray:
    """Two fields; the odd rows show the texture moved by some pixels."""
    frame = shifted(0).copy()
    frame[1::2] = shifted(pixels)[1::2]
    return frame


def test_a_moving_image_of_two_fields_has_a_comb_and_one_of_one_field_has_none():
    assert comb_ratio(woven(6)) > 1.1
    assert comb_ratio(shifted(6)) < 0.9
    assert comb_ratio(first_field(woven(6))) < 0.9


@pytest.mark.parametrize("channels", [1, 3])
def test_white_noise_is_no_comb(channels):
    assert comb_ratio(picture(1, (640, 480), channels)) == pytest.approx(1, abs=0.03)
    assert comb_ratio(np.full((2, 8), 7, np.uint8)) == comb_ratio(np.full((9, 8), 7, np.uint8)) == 0


def test_an_interlaced_video_is_read_and_reported(tmp_path):
    """OpenCV makes frames black that are marked as interlaced."""
    frames = [np.repeat(woven(6)[..., None], 3, axis=2)] * 3
    options = {"flags": "+ildct+ilme", "x264-params": "tff=1", "crf": "10"}
    path = write_by_pyav(tmp_path / "v.mp4", frames, codec="libx264", options=options)
    source = open_video(path)
    seen = list(source.frames())
    assert len(seen) >= 2
    assert all(abs(frame.gray.astype(float) - first_field(woven(6))).mean() < 8 for frame in seen)
    assert any("interlaced" in note for note in source.notes)


def test_a_dithered_gif_keeps_all_its_rows(tmp_path):
    Image = pytest.importorskip("PIL.Image")
    rows = np.where(np.arange(48) % 2, 96, 160)[:, None]  # the levels of an ordered dither, row by row
    ramp = np.tile(np.linspace(0, 255, 64), (48, 1))
    frames = [(np.roll(ramp, 3 * k, axis=1) > rows).astype(np.uint8) * 255 for k in range(6)]
    for frame in frames:
        frame[::7, ::5] = 255
    assert comb_ratio(frames[0]) > 1.1
    pictures = [Image.fromarray(frame) for frame in frames]
    pictures[0].save(tmp_path / "a.gif", save_all=True, append_images=pictures[1:], duration=40)
    source = open_video(tmp_path / "a.gif")
    read = [frame.image for frame in source.frames()]
    assert not source.notes or all("interlaced" not in note for note in source.notes)
    for expected, image in zip(frames, read, strict=True):
        assert np.abs(image.max(axis=-1).astype(int) - expected).max() < 30
