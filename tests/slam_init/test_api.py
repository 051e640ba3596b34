"""The public face of the package: names, short texts, logging."""

import logging
from pathlib import PurePath

import pytest
from path_types import OtherPath

import slam_init
from slam_init import Config, Initializer, load_config, load_graph, run


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="Initialiser"):
        slam_init.Initialiser  # noqa: B018


def test_attempts_are_logged_and_nothing_is_printed(room, caplog, capfd):
    with caplog.at_level(logging.DEBUG, logger="slam_init"):
        initializer = Initializer(room.camera)
        for frame in room.frames(max_frames=4):
            initializer.process(frame)
    levels = {record.levelname for record in caplog.records}
    assert levels <= {"DEBUG", "INFO"} and "DEBUG" in levels
    assert any("static_camera" in record.getMessage() for record in caplog.records)
    assert capfd.readouterr() == ("", "")


def test_results_are_written_to_and_read_from_any_path(room, tmp_path, room_run):
    out = OtherPath(tmp_path / "out")
    result, _ = run(room, room.camera, Config(), out=out, max_frames=2)
    assert not result and (tmp_path / "out" / "summary.json").is_file()
    assert load_config(OtherPath(tmp_path / "out" / "config.toml")) == Config()
    graph, values = load_graph(PurePath(room_run.out))
    assert graph.size() > 0 and values.size() > 0
