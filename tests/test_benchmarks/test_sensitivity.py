"""The sensitivity program changes a number wherever it is held, and tells which decisions differ."""

import json
import sys
from types import ModuleType

import numpy as np
import pytest

from tests.benchmarks import sensitivity
from tests.benchmarks.sensitivity import Change


@pytest.mark.parametrize(
    ("value", "halved", "doubled"),
    [
        (4.0, 2.0, 8.0),
        (0.3, 0.15, 0.6),
        (0.5, 0.25, 0.75),
        (0.9, 0.45, 0.95),
        (3, 2, 6),
        (1, 1, 2),
        ((4, 0.2), (2, 0.1), (8, 0.4)),
    ],
)
def test_numbers_are_halved_and_doubled_and_large_shares_stay_below_one(value, halved, doubled):
    assert sensitivity.scaled(value, 0.5) == halved
    assert sensitivity.scaled(value, 2.0) == doubled
    array = np.array([1.0, 3.0])
    assert sensitivity.scaled(array, 2.0).tolist() == [2.0, 6.0]


def test_a_change_reaches_all_modules_that_hold_the_number(monkeypatch):
    value = 7.5
    home, user, other = (ModuleType(f"slam_init.{name}") for name in ("home", "user", "other"))
    home.LEVEL = user.LEVEL = value
    other.LEVEL = 3.0  # another number of the same name
    for module in (home, user, other):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    sensitivity.apply(Change("slam_init/home.py", "LEVEL", "level", 2.0))
    assert (home.LEVEL, user.LEVEL, other.LEVEL) == (15.0, 15.0, 3.0)


def test_the_numbers_of_depth_and_of_joins_do_not_decide_on_a_map_by_tracks():
    sensitivity.load_all()
    names = {change.name for change in sensitivity.changes()}
    assert {"ON_BODIES", "FLOOR", "KNOWN_SHARE"} <= names
    assert not {"LARGEST_DEPTH_VOTE", "MAX_RISK", "WRONG_DIRECTION_DEG"} & names


def test_the_table_tells_what_differs_and_lists_what_does_not(tmp_path):
    log = tmp_path / "log.jsonl"
    base = [["correct", 3, 0.001], ["none", 9, 0.0]]
    other = [["correct", 5, 0.001], ["false", 9, 0.004]]
    lines = [([], base), (["a.py", "MOVES", "level", 0.5], other), (["a.py", "MOVES", "level", 2.0], base)]
    lines += [(["b.py", "STAYS", "assumption", factor], base) for factor in (0.5, 2.0)]
    log.write_text("".join(json.dumps({"change": c, "decisions": d, "commit": "abc"}) + "\n" for c, d in lines))
    table = sensitivity.report([log])
    row = next(line for line in table.splitlines() if "MOVES" in line)
    assert [cell.strip() for cell in row.split("|")[4:8]] == ["2", "1/1/0, 7.00", "0", "1/0/1, 3.00"]
    assert "No decision differs, halved or doubled (1 numbers): `STAYS` (b)." in table
