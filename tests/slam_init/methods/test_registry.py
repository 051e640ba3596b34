"""The names of the methods: each is described and can be made, and other names are errors."""

import pytest
from add_a_method import MedianParallax
from make_source import synth
from paths import ROOT

from slam_init.config import Config
from slam_init.errors import ConfigError
from slam_init.methods import METHODS, MethodInfo, make_two_view, method_info
from slam_init.methods.external_command import method_label
from slam_init.runner import run


def test_other_names_are_errors_with_a_way_out():
    for name, message in (
        ("magic", "--list-methods names all"),
        ("no_such_module:Method", "cannot be made"),
        ("slam_init.types.arrays:Nothing", "cannot be made"),
        ("slam_init.types.arrays:Pose", "cannot be made"),
        ("slam_init.config:Config", "not a two-view method"),
        ("sys:exit", "cannot be made: SystemExit"),
        ("quest", "use make_initializer"),
    ):
        with pytest.raises(ConfigError, match=message):
            make_two_view(name)


def test_a_method_whose_package_is_not_installed_names_the_package(monkeypatch):
    monkeypatch.setitem(METHODS, "rare", MethodInfo("rare", "-", "slam_init.config:Config", "no_such_package"))
    with pytest.raises(ConfigError, match="pip install no_such_package"):
        make_two_view("rare")


def test_a_method_of_your_own_is_imported_by_its_path(tmp_path):
    """As the command line runs the example; the summary and the configuration name the method."""
    name = "add_a_method:MedianParallax"
    assert method_info(name).home == name
    assert isinstance(make_two_view(name), MedianParallax)
    room = synth("room", width=320, height=240)
    result, summary = run(room, room.camera, Config(method=name), out=tmp_path)
    assert result
    assert summary.method == name
    assert summary.ground_truth.direction_error_deg < 5
    assert name in (tmp_path / "config.toml").read_text()
    assert (tmp_path / "recording.rrd").stat().st_size > 0


def test_a_method_in_a_file_is_made_by_its_path_and_labelled_by_its_name(tmp_path, monkeypatch):
    file = ROOT / "docs" / "examples" / "add_a_method.py"
    monkeypatch.chdir(tmp_path)
    name = f"{file}:MedianParallax"
    assert type(make_two_view(name)) is type(make_two_view(name))  # the file is executed once
    assert method_label(name) == "add_a_method:MedianParallax"
    with pytest.raises(ConfigError, match=r"there is no file .*nothing\.py"):
        make_two_view("nothing.py:MedianParallax")
