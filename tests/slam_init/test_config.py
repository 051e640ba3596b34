"""The configuration: what is written is read back, what is not understood is refused in one line."""

import dataclasses
import math
import os

import pytest

from slam_init.config import AcceptanceConfig, Config, config_toml, load_config
from slam_init.errors import ConfigError


def written(tmp_path, text):
    path = tmp_path / "config.toml"
    path.write_text(text, encoding="utf-8")
    return path


def leaves(config, prefix=()):
    """(path, value) of every option."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from leaves(value, (*prefix, field.name))
        else:
            yield (*prefix, field.name), value


def as_toml(path, value):
    *table, key = path
    return (f"[{'.'.join(table)}]\n" if table else "") + f"{key} = {value}\n"


OPTIONS = dict(leaves(Config()))
SECTIONS = {"": Config()} | {f"{f.name}.": getattr(Config(), f.name) for f in dataclasses.fields(Config)}
RANGES = {
    section + field.name: field.metadata["range"]
    for section, options in SECTIONS.items() if dataclasses.is_dataclass(options)
    for field in dataclasses.fields(options) if "range" in field.metadata
}  # fmt: skip
NUMBERS = {path: value for path, value in OPTIONS.items() if type(value) in (int, float)}
SWITCHES = {path: value for path, value in OPTIONS.items() if type(value) is bool}


def test_nothing_given_is_the_defaults():
    assert load_config(None) == Config()
    assert load_config(None, {"seed": None, "method": None}) == Config()


def test_every_option_can_be_set_and_comes_back(tmp_path):
    for path, default in NUMBERS.items():
        value = 2 * default + 1
        if value > RANGES[".".join(path)][1]:
            value = 0.9 * default
        changed = load_config(written(tmp_path, as_toml(path, value)))
        assert dict(leaves(changed)) == OPTIONS | {path: value}
        assert load_config(written(tmp_path, config_toml(changed))) == changed


def test_a_switch_is_true_or_false_and_nothing_else(tmp_path):
    for path in SWITCHES:
        for value in (True, False):
            read = load_config(written(tmp_path, as_toml(path, str(value).lower())))
            assert dict(leaves(read)) == OPTIONS | {path: value}
            assert load_config(written(tmp_path, config_toml(read))) == read
        for value in ("1", "0", '"yes"', "1.0"):
            with pytest.raises(ConfigError, match=f"{path[-1]} must be of type bool"):
                load_config(written(tmp_path, as_toml(path, value)))


def test_options_of_the_command_line_win_over_the_file(tmp_path):
    path = written(tmp_path, "seed = 3\n")
    assert load_config(path).seed == 3
    assert load_config(path, {"seed": 5}).seed == 5
    assert load_config(path, {"seed": 0}).seed == 0


MAY_BE_ZERO = {
    ("seed",),
    ("acceptance", "min_parallax_deg"),
    ("acceptance", "lens_changes"),
    ("map", "lens_uncertainty"),
}


def test_a_value_that_is_none_is_refused_by_name(tmp_path):
    for path in NUMBERS:
        values = ["-1", "nan", "inf", "-inf", '"many"', "true", "[1]", *(["0"] if path not in MAY_BE_ZERO else [])]
        values.append(str(2 * RANGES[".".join(path)][1]))
        for value in values:
            with pytest.raises(ConfigError, match=path[-1]) as refusal:
                load_config(written(tmp_path, as_toml(path, value)))
            assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 250


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sead = 3\n", "sead"),
        ("[tracking]\nmax_trax = 3\n", "tracking.max_trax"),
        ("[nothing]\n", "nothing"),
        ('[map]\n_name = "map"\n', "unknown key 'map._name'"),
        ("tracking = 3\n", "tracking must be a table"),
        ("seed = 1.5\n", "seed must be of type int"),
        (f"[map]\nnoise_px = 1{400 * '0'}\n", "map.noise_px must be of type float"),
        ("method = 3\n", "method must be of type str"),
        ("seed = \n", "not valid TOML"),
        ("seed = 1\nseed = 2\n", "not valid TOML"),
    ],
)
def test_what_is_not_understood_is_refused_in_one_line(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message) as refusal:
        load_config(written(tmp_path, text))
    assert "\n" not in str(refusal.value)


def test_a_risk_is_a_probability_above_what_is_not_modelled(tmp_path):
    for risk in (0.0, 0.001, 1.0001, math.nan):
        with pytest.raises(ConfigError, match=r"acceptance\.max_risk is"):
            AcceptanceConfig(max_risk=risk)
    for risk in (0.0011, 1.0):
        assert load_config(written(tmp_path, f"[acceptance]\nmax_risk = {risk}\n")).acceptance.max_risk == risk


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path / "missing.toml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigError, match="not a file"):  # and not waited for
        load_config(tmp_path / "pipe")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_config(binary)
