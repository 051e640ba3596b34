"""Plain folders of images: their order and their time stamps."""

import numpy as np
import pytest
from make_files import write, write_image
from path_types import PATH_TYPES

from slam_init.datasets import open_source
from slam_init.datasets.folder import find_images, open_folder
from slam_init.errors import SourceError


def test_an_image_folder_is_read_in_natural_order_at_a_nominal_rate(tmp_path):
    for name in ("img10.png", "img2.png", "img1.jpg", ".hidden.png", "notes.txt"):
        write_image(tmp_path / name) if name[-3:] != "txt" else write(tmp_path / name, "no image")
    source = open_source(str(tmp_path))
    assert source.kind == "images" and source.camera is None and source.groundtruth is None
    assert [frame.name for frame in source.frames()] == ["img1.jpg", "img2.png", "img10.png"]
    np.testing.assert_allclose(source.timestamps_s, [0, 1 / 30, 2 / 30])


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["1305031453.359684.png", "1305031453.391690.png"], [1305031453.359684, 1305031453.391690]),
        (
            ["1403715273262142976.png", "1403715273312143104.png"],
            [1403715273.262142976, 1403715273.312143104],
        ),
        (["000012.png", "000013.png"], [0, 1 / 30]),
        (["1305031453.5.png", "1305031453.5.jpg"], [0, 1 / 30]),
    ],
)
def test_names_in_seconds_or_nanoseconds_are_time_stamps_if_they_increase(tmp_path, names, expected):
    for name in names:
        write_image(tmp_path / "images" / name)
    assert open_source(str(tmp_path)).timestamps_s.tolist() == expected


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_the_readers_of_a_folder_take_every_type_of_path(tmp_path, path_type):
    write_image(tmp_path / "images" / "1.png")
    assert find_images(path_type(tmp_path)) == [tmp_path / "images" / "1.png"]
    assert len(open_folder(path_type(tmp_path))) == 1


def test_a_folder_without_images_is_refused(tmp_path):
    with pytest.raises(SourceError, match="no image"):
        open_folder(tmp_path)
