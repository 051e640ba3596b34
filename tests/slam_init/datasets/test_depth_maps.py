"""Folders of depths: files by the names of the frames or by their times; what is wrong is one line."""

import cv2
import numpy as np
import pytest
from make_files import picture, write_image

from slam_init import Initializer
from slam_init.cli import main
from slam_init.datasets import open_source
from slam_init.datasets.depth_maps import DepthFolder, DepthSource, read_depth
from slam_init.errors import SourceError
from slam_init.types.depth import Depth
from slam_init.types.frame import Frame

METRES = np.array([[0.0, 1.5, 2.0], [3.0, 4.0, 65.535]])


def frame(name, time_s=0.0):
    return Frame(0, time_s, name, np.zeros((4, 6), np.uint8))


def write_png(path, metres, factor=1000):
    path.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(path), np.round(metres * factor).astype(np.uint16))


@pytest.mark.parametrize(
    ("file", "named"),
    [
        ("a.jpg.png", "a.jpg"),
        ("a.png", "a.jpg"),
        ("frame-000001.depth.png", "frame-000001.color.png"),
        ("1305031453.374112.png", "1305031453.359684.png"),
    ],
)
def test_the_depth_of_a_frame_is_found_by_its_name_or_its_time(tmp_path, file, named):
    write_png(tmp_path / "depth" / file, METRES)
    depth = DepthFolder(tmp_path / "depth", "metric")(frame(named, 1305031453.359684))
    assert depth is not None
    expected = np.where((METRES == 0) | (METRES > 65), np.nan, METRES)
    np.testing.assert_allclose(depth.values, expected)


@pytest.mark.parametrize("suffix", ["npz", "npy"])
def test_arrays_keep_what_is_unknown(tmp_path, suffix):
    values = np.where(METRES == 0, np.nan, METRES)
    path = tmp_path / f"a.{suffix}"
    np.savez(path, depth=values) if suffix == "npz" else np.save(path, values)
    np.testing.assert_allclose(read_depth(path, tmp_path), values)


def test_a_frame_without_a_file_has_no_depth_but_the_first_one_needs_one(tmp_path):
    write_png(tmp_path / "depth" / "a.png", METRES)
    folder = DepthFolder(tmp_path / "depth", "scale")
    with pytest.raises(SourceError, match=r"no depth for the frame b\.png"):
        folder(frame("b.png"))
    assert folder(frame("a.png")) is not None
    assert folder(frame("b.png")) is None


@pytest.mark.parametrize("content", ["colour", "text", "no array", "a vector"])
def test_files_that_are_no_depth_are_refused(tmp_path, content):
    path = tmp_path / ("a.png" if content in ("colour", "text") else "a.npz")
    if content == "colour":
        cv2.imwrite(str(path), np.zeros((4, 6, 3), np.uint8))
    elif content == "text":
        path.write_text("metres")
    else:
        np.savez(path, **{"z" if content == "no array" else "depth": np.ones(4)})
    with pytest.raises(SourceError) as error:
        read_depth(path, tmp_path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_function_gives_the_depths_of_a_source(tmp_path):
    for i in range(2):
        write_image(tmp_path / "images" / f"{i}.jpg", picture(i))
    source = DepthSource(
        open_source(str(tmp_path / "images")),
        lambda one: Depth(one.image[..., 0] + 1.0, "scale") if one.index else None,
    )
    first, second = source.frames()
    assert first.depth is None
    assert second.depth.values.shape == second.image.shape[:2]
    assert "function" in source.notes[-1]


def test_the_command_line_takes_depths_and_says_what_is_wrong_with_them(tmp_path, capsys):
    write_png(tmp_path / "depth" / "other.png", METRES)
    for i in range(2):
        write_image(tmp_path / "images" / f"{i}.jpg", picture(i))
    run = ["run", str(tmp_path / "images"), "--out", str(tmp_path / "out"), "--quiet"]
    for options in (["--depth", str(tmp_path / "none")], ["--depth", str(tmp_path / "depth")]):
        assert main([*run, *options]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    write_png(tmp_path / "depth" / "0.png", METRES)
    assert main([*run, "--depth", str(tmp_path / "depth"), "--depth-kind", "inverse"]) == 3


@pytest.mark.parametrize(("unknown", "kind"), [(np.nan, "inverse"), (0.0, "metric"), (np.inf, "scale")])
def test_depths_without_a_value_are_told(room, unknown, kind):
    notes = {}
    for known in (False, True):
        initializer = Initializer(room.camera)
        for frame, values in zip(room.frames(0, 2), (np.full((4, 6), unknown), np.ones((4, 6))), strict=True):
            initializer.process(frame, depth=Depth(values if known else np.full((4, 6), unknown), kind))
        notes[known] = [note for note in initializer.finish().notes if "depth" in note]
    assert notes == {
        False: ["no depth was usable: those of 2 frames are NaN, infinite or not positive at tracks"],
        True: [],
    }
