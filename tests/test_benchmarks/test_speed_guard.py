"""The guard of the speed: ratios of rounds with their interval, and which changes are regressions."""

import math
import subprocess
import sys

import numpy as np
import pytest

from tests.benchmarks import speed_guard
from tests.benchmarks.speed_guard import changes_of, changes_table, main


def rounds(ratio, count=8, spread=0.02, seed=0):
    """Rounds of one task on a machine whose load differs from round to round."""
    rng = np.random.default_rng(seed)
    load = rng.uniform(0.5, 3.0, count)
    noise = np.exp(spread * rng.normal(size=count))
    return [({"frame": one}, {"frame": one * ratio * chance}) for one, chance in zip(load, noise, strict=True)]


def test_the_ratio_does_not_depend_on_the_load_that_both_share():
    (change,) = changes_of(rounds(1.3))
    assert change.ratio == pytest.approx(1.3, rel=0.03)
    assert change.low < change.ratio < change.high < 1.05 * change.low


def test_swapping_the_commits_inverts_the_ratio_and_its_interval():
    given = rounds(1.3)
    (forth,), (back,) = changes_of(given), changes_of([(new, old) for old, new in given])
    assert back.ratio == pytest.approx(1 / forth.ratio)
    assert (back.low, back.high) == pytest.approx((1 / forth.high, 1 / forth.low))


def test_nineteen_of_twenty_intervals_hold_the_truth():
    held = sum(
        one.low <= 1.05 <= one.high for seed in range(400) for one in changes_of(rounds(1.05, 5, 0.1, seed=seed))
    )
    assert 0.92 < held / 400 < 0.98


@pytest.mark.parametrize(("ratio", "regression"), [(1.3, True), (1.05, False), (0.8, False)])
def test_a_regression_is_a_change_whose_whole_interval_is_above_the_limit(ratio, regression):
    (change,) = changes_of(rounds(ratio))
    assert change.is_regression(1.1) is regression


def test_a_single_round_proves_nothing():
    (change,) = changes_of(rounds(5.0, 1))
    assert (change.low, change.high) == (0.0, math.inf)
    assert not change.is_regression(1.1)


def test_a_task_that_one_commit_lacks_is_listed_and_not_compared():
    old, new = changes_of([({"old only": 2.0}, {"new only": 3.0})])
    assert (old.old, old.new, old.rounds) == (2.0, None, 0)
    assert (new.old, new.new, new.rounds) == (None, 3.0, 0)
    table = changes_table([old, new], 1.1)
    assert "old only" in table
    assert "above" not in table


@pytest.fixture
def trees(tmp_path, monkeypatch):
    """Two folders that look like checkouts."""
    for name in ("old", "new"):
        (tmp_path / name / "slam_init").mkdir(parents=True)
    return tmp_path / "old", tmp_path / "new"


@pytest.mark.parametrize(("factor", "code"), [(1.5, 1), (1.0, 0)])
def test_the_exit_code_tells_a_regression(factor, code, trees, monkeypatch, capsys):
    measured = []

    def measure(tree):
        measured.append(tree.name)
        return {"frame": (factor if tree.name == "new" else 1.0) * (1 + 0.001 * len(measured))}

    monkeypatch.setattr(speed_guard, "measure_tree", measure)
    assert main([*map(str, trees), "--rounds", "4"]) == code
    assert "frame" in capsys.readouterr().out
    assert measured[2:6] in (["old", "new", "new", "old"], ["new", "old", "old", "new"])


def test_without_a_common_task_the_exit_code_is_two(trees, monkeypatch):
    monkeypatch.setattr(speed_guard, "measure_tree", lambda tree: {tree.name: 1.0})
    assert main([*map(str, trees), "--rounds", "2"]) == 2


def test_folders_that_are_no_two_checkouts_are_refused(trees, tmp_path):
    for pair in ((trees[0], tmp_path), (trees[0], trees[0])):
        with pytest.raises(SystemExit):
            main([str(one) for one in pair])


def test_a_checkout_that_cannot_be_measured_is_an_error_with_its_cause(trees, monkeypatch):
    def fails(*_, **__):
        return subprocess.CompletedProcess([sys.executable], 1, "", "ImportError: no such module")

    monkeypatch.setattr(speed_guard.subprocess, "run", fails)
    with pytest.raises(RuntimeError, match="no such module"):
        speed_guard.measure_tree(trees[0])
