"""Interlaced frames: found by their comb, and replaced by one field. Images of one time are never taken for them."""

import numpy as np
import pytest
from make_files import picture
from make_scene import texture
from make_video import write_by_pyav

from slam_init.datasets.video import comb_ratio, first_field, open_video

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
