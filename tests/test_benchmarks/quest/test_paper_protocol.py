"""The synthetic experiment of the paper: its problems, its measures, and the output of the program."""

from __future__ import annotations

import numpy as np
import pytest

from quest.geometry.epipolar import depths_from_pose, sampson_error
from quest.geometry.quaternion import matrix_from_quaternion, multiply
from quest.registry import SOLVERS
from tests.benchmarks.quest import paper_protocol
from tests.benchmarks.quest.contestants import Contestant, contestants, one_by_one
from tests.benchmarks.quest.paper_problems import draw_problems, rotation_error
from tests.benchmarks.quest.paper_tables import measure


@pytest.mark.parametrize("coplanar", [False, True])
def test_problems_obey_their_pose_and_lie_in_both_images(coplanar: bool):
    p = draw_problems(np.random.default_rng(0), 10, 8, 0.0, coplanar=coplanar, witnesses=20)
    assert p.m.shape == p.n.shape == (10, 28, 3)
    for m, n, q, t in zip(p.m, p.n, p.q, p.t, strict=True):
        R = matrix_from_quaternion(q)
        u, v = depths_from_pose(R, t, m, n)
        assert np.abs(sampson_error(R, t, m, n)).max() < 1e-12
        assert min(u.min(), v.min()) > 0
        for rays in (m, n):
            assert (np.abs(800 * rays[:, :2] / rays[:, 2:]) <= (320 + 1e-9, 240 + 1e-9)).all()
        if coplanar:
            values = np.linalg.svd(u[:, None] * m - (u[:, None] * m).mean(axis=0), compute_uv=False)
            assert values[2] < 1e-12


def test_noise_is_in_pixels_of_both_images():
    exact, noisy = (draw_problems(np.random.default_rng(0), 1, 8, noise, witnesses=2000) for noise in (0.0, 2.0))
    for a, b in ((exact.m, noisy.m), (exact.n, noisy.n)):
        moved = 800 * (b[..., :2] / b[..., 2:] - a[..., :2] / a[..., 2:])
        assert moved.std() == pytest.approx(2.0, rel=0.1)


def test_the_error_is_at_most_one_half_and_independent_of_the_sign():
    q = np.array([[1.0, 0, 0, 0]])
    quarter = np.array([[[np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)]]])
    assert rotation_error(quarter, q) == pytest.approx([0.25])
    assert rotation_error(-quarter, q) == pytest.approx([0.25])
    assert rotation_error(np.array([[[0.0, 1, 0, 0]]]), q) == pytest.approx([0.5])
    assert rotation_error(np.full((1, 3, 4), np.nan), q) == pytest.approx([0.5])


def test_the_true_rotation_has_no_error_and_a_half_turn_off_has_the_largest():
    p = draw_problems(np.random.default_rng(0), 5, 8, 0.5, witnesses=30)
    right = measure(Contestant("truth", 8, lambda m, n: p.q[:, None]), p, refined=5)
    assert right.closest.max() == pytest.approx(0, abs=1e-12)
    assert right.direction_of_first == pytest.approx(right.direction, abs=0.01)
    assert (right.candidates, right.reached_by_first, right.reached_by_four) == (1, 1, 1)
    away = multiply(p.q, [0.0, 0, 1, 0])[:, None]
    wrong = measure(Contestant("away", 8, lambda m, n: away), p, refined=5)
    assert wrong.closest == pytest.approx(np.full(5, 0.5))
    assert wrong.reached_by_four == 0


def test_a_solver_without_candidates_has_the_largest_error():
    p = draw_problems(np.random.default_rng(0), 5, 8, 0.5, witnesses=30)
    none = measure(Contestant("none", 8, lambda m, n: np.full((5, 2, 4), np.nan)), p, refined=5)
    assert (none.closest == 0.5).all()
    assert (none.direction == 1).all()
    assert (none.candidates, none.reached_by_first, none.reached_by_four) == (0, 0, 0)


def test_all_solvers_are_compared_and_one_by_one_equals_the_batch():
    chosen = contestants()
    assert {solver.name for solver in SOLVERS.values()} <= {one.name for one in chosen}
    assert len({one.name for one in chosen}) == len(chosen)
    p = draw_problems(np.random.default_rng(0), 4, 8, 0.5)
    singly = one_by_one(SOLVERS["eight_point"].function)(p.m, p.n)
    assert np.sort(singly, axis=1) == pytest.approx(np.sort(SOLVERS["eight_point"].function(p.m, p.n), axis=1))


def test_the_five_point_solver_equals_that_of_opencv():
    p = draw_problems(np.random.default_rng(0), 10, 5, 0.5)
    (opencv,) = (one for one in contestants() if one.name == "5-point of OpenCV")
    ours = SOLVERS["five_point"].function(p.m, p.n)
    for mine, theirs in zip(ours, opencv.solve(p.m, p.n), strict=True):
        known = theirs[np.isfinite(theirs[:, 0])]
        assert len(known) == np.isfinite(mine[:, 0]).sum()
        assert rotation_error(np.repeat(mine[None], len(known), axis=0), known).max() < 1e-6


def test_the_program_writes_what_it_prints_and_a_plot(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="the plot needs the extra bench")
    paper_protocol.main(["--problems", "2", "--refined", "1", "--out", str(tmp_path)])
    shown = capsys.readouterr().out
    assert shown == (tmp_path / "paper_protocol.md").read_text()
    assert "| QuEst 6 fast " in shown
    assert (tmp_path / "paper_protocol.png").stat().st_size > 10_000
