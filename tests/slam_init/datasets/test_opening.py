"""Detection of the kind of a source, and refusal of texts and data sets of one's own that are none."""

import zlib

import pytest
from make_files import write, write_image
from make_layouts import eth3d
from path_types import PATH_TYPES, OtherPath

from slam_init.datasets import detect_kind, open_source
from slam_init.errors import SourceError


@pytest.mark.parametrize("path_type", PATH_TYPES)
def test_a_source_is_opened_from_every_type_of_path(tmp_path, path_type):
    folder = eth3d(tmp_path / "a séquence with spaces")
    assert detect_kind(path_type(folder)) == "tum"
    assert open_source(path_type(folder)).name == folder.name


def test_a_synthetic_source_may_be_named_by_a_path_like_object():
    assert open_source(OtherPath("synth:room?frames=2&width=64&height=64"), seed=1).kind == "synth"


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("synth:nowhere", "room"),
        ("synth:", "room"),
        ("synth:room?magic=1", "magic"),
        ("synth:room?noise=loud", "noise"),
        ("synth:room?frames=0", "frames"),
        ("/no/such/place", "no such"),
        ("", "no sequence|no such"),
        ("a\0b", "cannot be read|no such"),
        ("x" * 5000, "cannot be read|no such"),
    ],
)
def test_an_invalid_source_is_refused_in_one_line(text, word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SourceError, match=word):
        open_source(text)


def test_a_folder_of_sequences_or_videos_names_them(tmp_path):
    eth3d(tmp_path / "runs" / "second")
    write_image(tmp_path / "runs" / "first" / "0.png")
    write(tmp_path / "runs" / "notes" / "a.txt", "no sequence")
    write(tmp_path / "runs" / "notes.txt", "no sequence")
    for name in ("clip10.mp4", "clip2.MOV", "clip1.avi", "clip3.mkv", "clip4.mp4", "list.csv"):
        write(tmp_path / "videos" / name, b"\0")
    for folder, words in (
        ("runs", r"runs: is not one sequence: give one of those in it: first, second$"),
        ("videos", r"give one of those in it: clip1.avi, clip2.MOV, clip3.mkv and 2 more$"),
    ):
        with pytest.raises(SourceError, match=words):
            open_source(tmp_path / folder)


def test_a_folder_without_a_sequence_is_refused_with_the_known_layouts(tmp_path):
    with pytest.raises(SourceError, match=r"rgb.txt.*EuRoC.*KITTI.*images"):
        detect_kind(str(tmp_path))
    write_image(tmp_path / "only.png")
    with pytest.raises(SourceError, match="folder"):
        detect_kind(str(tmp_path / "only.png"))


# -- data sets of one's own ------------------------------------------------------------------------


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
        ("[0.0, 0.1]", "[0.0, 100.0]", "steps by 100: give seconds"),
        ("[0.0, 0.1]", "[-1.0, 0.1]", "negative"),
        ("[0.0, 0.1]", "[0.0, float('nan')]", "finite"),
        ("class", "1 = class", r"cannot be opened \(cannot assign"),
        ("class", "1 / 0\nclass", r"cannot be opened \(division by zero at own_\d+\.py:5\)"),
        ("class", "raise SystemExit(7)\nclass", r"cannot be opened \(7 at own_\d+\.py:5\)"),
        ("camera = groundtruth = None", f"camera = None; {MIRRORED}", "no rotation"),
    ],
)
def test_a_source_of_the_user_that_is_none_is_reported_in_one_line(tmp_path, monkeypatch, before, after, words):
    text = SOURCE.replace(before, after)
    module = f"own_{zlib.crc32(text.encode())}"  # a module is imported once
    (tmp_path / f"{module}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(SourceError, match=words):
        open_source(f"python:{module}:Source")
