"""A data set of one's own that is none is refused in one line."""

import zlib

import pytest

from slam_init.datasets import open_source
from slam_init.errors import SourceError

SOURCE = """
import numpy as np
from slam_init import Pose, Trajectory

class Source:
    name = kind = "own"
    camera = groundtruth = None
    timestamps_s = [0.0, 0.1]
    def __len__(self): return 2
    def frames(self, start=0, max_frames=None): return iter(())
"""
MIRRORED = "groundtruth = Trajectory(np.arange(2.0), (Pose(-np.eye(3), np.zeros(3)),) * 2)"


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("def frames", "def images", "no frames"),
        ("[0.0, 0.1]", "[0.1, 0.1]", "after"),
        ("[0.0, 0.1]", "[0.1]", "shape"),
        ("[0.0, 0.1]", "['a', 'b']", "numbers"),
        ("[0.0, 0.1]", "[0.0, float('nan')]", "finite"),
        ("class", "1 = class", r"cannot be opened \(cannot assign"),
        ("class", "1 / 0\nclass", r"cannot be opened \(division by zero\)"),
        ("class", "raise SystemExit(7)\nclass", r"cannot be opened \(7\)"),
        ("camera = groundtruth = None", f"camera = None; {MIRRORED}", "no rotation"),
    ],
)
def test_a_source_of_the_user_that_is_none_is_reported_in_one_line(tmp_path, monkeypatch, before, after, words):
    text = SOURCE.replace(before, after)
    module = f"own_{zlib.crc32(text.encode())}"  # a module is imported once
    (tmp_path / f"{module}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(SourceError, match=words) as raised:
        open_source(f"python:{module}:Source")
    assert "\n" not in str(raised.value)
