"""The benchmark of the risk: decisions are judged by the truth, and the tables add them up."""

import math
from dataclasses import replace

import pytest

from tests.benchmarks.reliability import Decision, by_another_hand, decide, decisions_of, main, read_log, report

#: A camera that moves sideways past points of other depths.
WORLDS = """
import numpy as np

def draw_factors(seed):
    return {"scene": "box", "still": bool(seed % 2)}

def make(factors):
    rng = np.random.default_rng(3)
    X = np.c_[rng.uniform(-.6, .6, (200, 2)), np.ones(200)] * rng.uniform(1, 2, (200, 1))
    frames, poses = [], []
    for k in range(6):
        t = np.array([0.0 if factors["still"] else .05 * k, 0, 0])
        pixels = 457 * (X - t)[:, :2] / X[:, 2:] + [319.5, 239.5] + rng.normal(size=(200, 2)) * .3
        keep = ((pixels >= 0) & (pixels <= [639, 479])).all(axis=1)
        frames.append((k, k / 30, np.flatnonzero(keep), pixels[keep]))
        poses.append((np.eye(3), t))
    return dict(W=640, H=480, fs=457.0, cs=[319.5, 239.5], frames=frames, poses=poses, notrans=factors["still"])
"""


@pytest.fixture(scope="module")
def worlds(tmp_path_factory):
    path = tmp_path_factory.mktemp("worlds") / "mine.py"
    path.write_text(WORLDS, encoding="utf-8")
    return by_another_hand(path)


def test_a_map_of_a_world_by_another_hand_is_judged_by_its_truth(worlds):
    (world,) = worlds(0)
    found = decide(world, 0)
    assert found.outcome == "correct"
    assert 0 < found.risk < 0.005
    assert found.direction_deg < 15
    wrong = replace(
        world, world_from_cam={k: replace(pose, t=pose.t[::-1]) for k, pose in world.world_from_cam.items()}
    )
    assert decide(wrong, 0).outcome == "false"


def test_every_map_of_a_camera_that_does_not_translate_is_false(worlds):
    (world,) = worlds(1)
    assert decide(world, 1).outcome == "none"
    (moving,) = worlds(0)
    assert decide(replace(moving, no_translation=True), 0).outcome == "false"


def test_the_tables_of_a_log_are_those_of_the_run(worlds, tmp_path, capsys):
    log = tmp_path / "log.jsonl"
    decisions = decisions_of(worlds, range(2), log)
    assert [one.outcome for one in read_log(log)] == [one.outcome for one in decisions]
    assert main(["--from-log", str(log)]) == 0
    assert "| box" in capsys.readouterr().out


def test_expected_and_observed_false_maps_are_added_up():
    some = [Decision(k, {"scene": "a"}, "correct", 3, False, "", 0.004, 1, 2, 0.5) for k in range(9)]
    some += [Decision(9, {"scene": "b"}, "false", 5, False, "", 0.003, 1, 20, 4.0)]
    some += [Decision(10, {"scene": "b"}, "none", 9, True, "pure_rotation")]
    text = report(some)
    assert "0.04" in text.split("false expected")[1]
    assert "2e-3" not in text
    assert math.isnan(some[-1].risk)
