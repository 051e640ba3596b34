"""Masks of a sequence: black is ignored; one for all frames, or one by name. What is wrong is one line."""

import numpy as np
import pytest
from make_files import picture, write_image

from slam_init.datasets import open_source
from slam_init.datasets.views import MaskedSource, SourceView, read_mask
from slam_init.errors import SourceError

LEFT = np.zeros((48, 64), np.uint8)
LEFT[:, 32:] = 255


@pytest.fixture
def source(tmp_path):
    for i in range(3):
        write_image(tmp_path / "images" / f"{i}.jpg", picture(i))
    return open_source(str(tmp_path / "images"))


def test_one_mask_holds_for_all_frames(source, tmp_path):
    write_image(tmp_path / "m.png", LEFT)
    masked = MaskedSource(source, tmp_path / "m.png")
    masks = [frame.mask for frame in masked.frames(1)]
    assert len(masks) == 2 and masks[0] is masks[1] and np.array_equal(masks[0], LEFT)
    assert "ignores 50.0%" in masked.notes[-1]


@pytest.mark.parametrize("suffix", [".png", ".jpg.png"])
def test_a_folder_has_a_mask_for_each_frame_by_its_name(source, tmp_path, suffix):
    for i in range(3):
        write_image(tmp_path / "masks" / f"{i}{suffix}", np.roll(LEFT, i, axis=1))
    for i, frame in enumerate(MaskedSource(source, tmp_path / "masks").frames()):
        assert np.array_equal(frame.mask, np.roll(LEFT, i, axis=1))


def test_black_is_ignored_and_nothing_else(tmp_path):
    image = np.full((48, 64, 3), (0, 0, 1), np.uint8)
    image[0] = 0
    write_image(tmp_path / "m.png", image)
    mask = read_mask(tmp_path / "m.png")
    assert mask.shape == (48, 64) and not mask[0].any() and (mask[1:] == 255).all()


def test_of_a_mask_of_16_bits_small_numbers_count(tmp_path):
    labels = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64)
    write_image(tmp_path / "m.png", labels)
    assert np.array_equal(read_mask(tmp_path / "m.png") > 0, labels > 0)


def test_a_mask_that_leads_out_of_its_folder_is_one_line(source, tmp_path):
    path = tmp_path / "masks"
    path.mkdir()
    write_image(tmp_path / "elsewhere.png", LEFT)
    (path / "0.png").symlink_to(tmp_path / "elsewhere.png")
    with pytest.raises(SourceError, match="leads out of the folder") as raised:
        list(SourceView(mask=str(path)).apply(source).frames())
    assert "\n" not in str(raised.value)
