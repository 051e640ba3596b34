"""Text tables of data sets: tolerant of their form, strict about their content."""

import numpy as np
import pytest
from make_files import write
from path_types import PATH_TYPES

from slam_init.datasets import open_source
from slam_init.datasets.text import read_rows, read_tum_trajectory


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff0 images/0.png\n1 images/1.png\n2 images/2.png",
        "0 images/0.png\r\n1 images/1.png  \r\n\r\n# end\r\n2\timages/2.png\r\n",
    ],
)
def test_text_files_may_have_a_byte_order_mark_crlf_blank_lines_and_comments(tum, text):
    write(tum / "rgb.txt", text)
    assert [frame.name for frame in open_source(str(tum)).frames()] == ["0.png", "1.png", "2.png"]


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_read_rows_takes_every_type_of_path(tmp_path, path_type):
    path = write(tmp_path / "a.txt", "# comment\n\n 1 2 \n")
    assert list(read_rows(path_type(path))) == [(f"{path}:3", "1 2")]


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_read_tum_trajectory_takes_every_type_of_path(tmp_path, path_type):
    path = write(tmp_path / "trajectory.txt", "0.5 1 2 3 0 0 0 1\n")
    np.testing.assert_array_equal(read_tum_trajectory(path_type(path)).at(0.5).t, [1, 2, 3])
