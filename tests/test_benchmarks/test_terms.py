"""The benchmark of the terms: a term refuses a window alone where all others together would accept it."""

import json

import numpy as np
import pytest

from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.pose import Pose
from tests.benchmarks.reliability import World
from tests.benchmarks.terms import main, refuses_alone, windows_of

MAX_RISK = 0.005


def window(last=None, **terms):
    """A window of a log whose first look found these terms, beside a floor of .001."""
    of_first = {"dir": 0.0, "rot": 0.0, "oth": 0.0, "riv": 0.0} | terms
    total = 0.001 + sum(of_first[name] for name in ("dir", "rot", "oth", "riv"))
    parts = dict.fromkeys(("rigid", "fix", "lens"), of_first["dir"])  # a part that changes nothing
    return {"wrong": True, "tot": total} | parts | of_first | ({} if last is None else {"last": last})


@pytest.mark.parametrize(
    ("of", "alone"),
    [
        (window(rot=0.2), {"rot"}),
        (window(rot=0.2, riv=0.3), set()),
        (window(last={"half": 0.01, "zrot": 0.0}), {"half"}),
        (window(rot=0.003, last={"half": 0.003}), {"rot", "half"}),
        (window(rot=0.003), set()),
        (window(dir=0.1, fix=0.001), {"dir", "fix"}),
        (window(dir=0.1, fix=0.05), {"dir"}),
    ],
)
def test_a_term_refuses_alone_what_the_others_accept(of, alone):
    names = ("dir", "rot", "oth", "riv", "rigid", "fix", "lens", "half", "zrot")
    assert {name for name in names if refuses_alone(name, of, MAX_RISK)} == alone


def still_or_sideways(still):
    """A camera that stands or moves sideways past points of other depths."""
    rng = np.random.default_rng(3)
    X = np.c_[rng.uniform(-0.6, 0.6, (200, 2)), np.ones(200)] * rng.uniform(1, 2, (200, 1))
    camera, views, poses = Camera("pinhole", 640, 480, 457.0, 457.0, 319.5, 239.5), [], {}
    for k in range(6):
        t = np.array([0.0 if still else 0.05 * k, 0.0, 0.0])
        pixels = 457 * (X - t)[:, :2] / X[:, 2:] + [319.5, 239.5] + rng.normal(size=(200, 2)) * 0.3
        keep = np.flatnonzero(((pixels >= 0) & (pixels <= [639, 479])).all(axis=1))
        views.append(Observations(k, k / 30, str(k), keep, pixels[keep], camera.bearings(pixels[keep])))
        poses[k] = Pose(np.eye(3), t)
    return World(camera, views, poses, still, {}, X)


def test_the_window_of_a_map_is_right_and_no_term_of_the_last_look_refuses_it():
    *_, last = windows_of(still_or_sideways(still=False))
    assert not last["wrong"]
    assert last["tot"] + sum(last["last"].values()) <= MAX_RISK
    assert set(last["last"]) >= {"bod", "zrot", "free", "half", "zmot"}


def test_all_windows_of_a_camera_that_does_not_translate_are_wrong():
    assert all(one["wrong"] for one in windows_of(still_or_sideways(still=True)))


def test_the_table_of_a_log_counts_worlds(tmp_path, capsys):
    log = tmp_path / "log.jsonl"
    world = json.dumps({"seed": 0, "rows": [window(rot=0.299)]})
    log.write_text(f"{world}\n{world}\n", encoding="utf-8")
    assert main(["--from-log", str(log)]) == 0
    table = capsys.readouterr().out
    assert "2 worlds, 2 judged windows, of which the best motion of 2 is wrong" in table
    assert [line.split("|")[2].strip() for line in table.splitlines() if line.startswith("| rotation")] == ["2"]
