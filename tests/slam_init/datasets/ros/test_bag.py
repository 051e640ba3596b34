"""Bags that are broken or hostile end in one line."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest
from make_bag import FORMATS, path_for, small_bag
from make_files import write

from slam_init.cli import main
from slam_init.datasets import open_source
from slam_init.errors import SourceError
from slam_init.types.camera import Camera

pytest.importorskip("rosbags")

CAMERA = Camera("pinhole", 64, 48, 60.0, 60.0, 31.5, 23.5)


@pytest.fixture(params=FORMATS)
def bag(request, tmp_path):
    images = np.random.default_rng(0).integers(0, 255, (3, 48, 64), np.uint8)
    return small_bag(request.param, images, CAMERA).write(path_for(tmp_path, request.param))


def storage(bag):
    return bag if bag.is_file() else next(path for path in bag.iterdir() if path.suffix != ".yaml")


def read(path) -> None:
    source = open_source(path)
    assert source.camera is None or source.groundtruth is None or list(source.frames())


@pytest.mark.parametrize("name", ["a.bag", "a.db3", "a.mcap"])
@pytest.mark.parametrize("data", [b"", b"garbage" * 100])
def test_a_file_that_is_no_bag_is_refused_by_name(tmp_path, name, data):
    with pytest.raises(SourceError, match=name):
        open_source(write(tmp_path / name, data))


@pytest.mark.parametrize("text", ["", "a: 1\n", "[" * 5000, "- " * 5000, "version: 99\nstorage_identifier: x\n"])
def test_broken_metadata_are_refused(tmp_path, text):
    write(tmp_path / "metadata.yaml", f"rosbag2_bagfile_information:\n {text}")
    with pytest.raises(SourceError, match="cannot be read"):
        open_source(tmp_path)


def test_metadata_that_name_a_missing_file_are_refused(bag):
    if bag.is_dir():
        storage(bag).unlink()
        with pytest.raises(SourceError, match="missing"):
            open_source(bag)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_and_a_link_out_of_the_folder_are_not_followed(tmp_path):
    images = np.zeros((3, 48, 64), np.uint8)
    folder = small_bag("sqlite3", images, CAMERA).write(tmp_path / "bag")
    file = storage(folder)
    file.rename(tmp_path / "elsewhere.db3")
    file.symlink_to(tmp_path / "elsewhere.db3")
    with pytest.raises(SourceError, match="leads out of the folder"):
        open_source(folder)
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(SourceError, match="named pipe"):
        open_source(folder)


def test_a_name_that_a_database_cannot_have_is_refused(tmp_path):
    folder = small_bag("sqlite3", np.zeros((1, 48, 64), np.uint8), CAMERA).write(tmp_path / "bag")
    folder = folder.rename(tmp_path / "100%41")
    with pytest.raises(SourceError, match="rename the bag"):
        open_source(folder)


def test_without_the_extra_the_command_says_what_to_install(bag, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rosbags", None)
    assert main(["info", str(bag)]) == 2
    assert capsys.readouterr().err.strip().endswith('pip install ".[ros]"')
