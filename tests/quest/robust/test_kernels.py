"""The compiled core: each function against its readable counterpart, and the laws of those that have none."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from quest.benchmarks.first_call import break_even, table
from quest.geometry.epipolar import depths_from_pose
from quest.geometry.quaternion import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotation_angle,
    rotation_from_vector,
)
from quest.geometry.refine import refine_pose, refine_rotation, sampson_jacobian, tangent_basis
from quest.robust import kernels
from quest.robust.pose_problem import CompiledPoseProblem, RelativePoseProblem
from quest.robust.ransac import draw_samples

SEEDS = st.integers(0, 2**32 - 1)
THRESHOLD_RAD = 2e-3
NOISE_RAD = 5e-4
#: The first call compiles, which no deadline should judge.
laws = settings(deadline=None, max_examples=40)


def unit(values) -> np.ndarray:
    a = np.asarray(values, float)
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def two_views(seed: int, count: int = 60, *, noise_rad: float = NOISE_RAD, wrong: int = 0, planar: bool = False):
    """A motion by up to 0.5 rad and the bearings of points in front of both cameras; the first matches are wrong."""
    rng = np.random.default_rng(seed)
    R = rotation_from_vector(rng.uniform(-0.3, 0.3, 3))
    t = unit(rng.normal(size=3))
    X = rng.uniform([-2, -2, 4], [2, 2, 8], (count, 3))
    if planar:
        X[:, 2] = 6 + 0.3 * X[:, 0] - 0.4 * X[:, 1]
    m, n = (unit(unit(rays) + noise_rad * rng.normal(size=X.shape)) for rays in (X, X @ R.T + t))
    n[:wrong] = unit(rng.uniform([-0.5, -0.5, 1], [0.5, 0.5, 1], (wrong, 3)))
    return R, t, m, n


def disturbed(R, t, seed: int, angle_rad: float):
    rng = np.random.default_rng([seed, 1])
    R, t = rotation_from_vector(angle_rad * unit(rng.normal(size=3))) @ R, unit(t + angle_rad * rng.normal(size=3))
    return np.ascontiguousarray(R), t


def random_pose(seed: int):
    return disturbed(rotation_from_vector(np.random.default_rng(seed).uniform(-1.5, 1.5, 3)), np.zeros(3), seed, 1.0)


def as_model(R, t) -> np.ndarray:
    return np.concatenate([quaternion_from_matrix(R), t])


def distance(R1, R2) -> float:
    return float(rotation_angle(R1 @ R2.T))


def assert_orthonormal(R) -> None:
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-12


# --- the small ones ---


@laws
@given(seed=SEEDS)
def test_the_tangents_are_the_tangent_basis(seed):
    t = unit(np.random.default_rng(seed).normal(size=3))
    first, second = tangent_basis(t).T
    x, y, z, u, v, w = kernels._tangents(t)
    assert [x, y, z] == pytest.approx(first, abs=1e-12)
    assert [u, v, w] == pytest.approx(second, abs=1e-12)


@laws
@given(seed=SEEDS, angle_rad=st.sampled_from([0.0, 1e-300, 1e-9, 0.99e-4, 1.01e-4, 0.1, 3.1]))
def test_a_turn_is_the_exponential_map_also_near_no_turn(seed, angle_rad):
    w = angle_rad * unit(np.random.default_rng(seed).normal(size=3))
    R, _ = random_pose(seed)
    expected = rotation_from_vector(w) @ R
    kernels._turn(R, *w)
    assert expected == pytest.approx(R, abs=1e-14)


@laws
@given(seed=SEEDS, size=st.integers(1, 6))
def test_elimination_solves(seed, size):
    rng = np.random.default_rng(seed)
    A, x = rng.normal(size=(size, size)), rng.normal(size=size)
    b = A @ x
    condition = np.linalg.cond(A)
    assert kernels._solve_in_place(A, b)
    assert b == pytest.approx(x, abs=1e-12 * condition)


def test_elimination_needs_pivots_and_says_where_there_are_none():
    swap, b = np.array([[0.0, 2.0], [4.0, 0.0]]), np.array([2.0, 8.0])
    assert kernels._solve_in_place(swap, b)
    assert b.tolist() == [2, 1]
    for singular in (np.zeros((3, 3)), np.ones((3, 3)), np.full((3, 3), np.nan)):
        assert not kernels._solve_in_place(singular, np.ones(3))


@laws
@given(seed=SEEDS)
def test_the_distance_of_two_poses_is_the_sum_of_two_angles(seed):
    (R1, t1), (R2, t2) = random_pose(seed), random_pose(seed // 2 + 1)
    expected = distance(R1, R2) + np.arccos(t1 @ t2)
    assert kernels._mode_distance(R1, t1, R2, t2) == pytest.approx(expected, abs=1e-7)
    assert kernels._mode_distance(R1, t1, R1, t1) < 1e-7


# --- residuals and score ---


def matches_of_all_kinds(seed: int):
    """Inliers, wrong matches, points behind both cameras or one of them, points at infinity."""
    R, t, m, n = two_views(seed, 80, wrong=20)
    m[20:30], n[20:30] = -m[20:30], -n[20:30]
    n[30:35] = -n[30:35]
    n[35:50] = m[35:50] @ R.T
    return R, t, m, n


@laws
@given(seed=SEEDS, angle_rad=st.sampled_from([0.0, 1e-3, 0.1, 2.0]))
def test_residuals_are_those_of_the_readable_problem(seed, angle_rad):
    R, t, m, n = matches_of_all_kinds(seed)
    R, t = disturbed(R, t, seed, angle_rad)
    (expected,), (expected_behind,) = RelativePoseProblem(m, n, THRESHOLD_RAD).residuals(as_model(R, t)[None])
    r2, behind = kernels.residuals(m, n, R, t, THRESHOLD_RAD)
    assert np.sqrt(r2) == pytest.approx(np.sqrt(expected), rel=1e-9, abs=1e-12)
    assert (behind == expected_behind).all()
    r2_of_model, behind_of_model = kernels.residuals_of_model(m, n, as_model(R, t), THRESHOLD_RAD)
    assert np.sqrt(r2_of_model) == pytest.approx(np.sqrt(r2), rel=1e-9, abs=1e-12)
    assert (behind_of_model == behind).all()


def test_a_match_on_both_epipoles_has_no_residual():
    t = np.array([0.0, 0.0, 1.0])
    r2, behind = kernels.residuals(t[None], t[None], np.eye(3), t, THRESHOLD_RAD)
    assert (r2.tolist(), behind.tolist()) == ([0.0], [False])


@laws
@given(seed=SEEDS, angle_rad=st.sampled_from([0.0, 1e-3, 0.1, 2.0]))
def test_the_score_is_the_cost_of_the_readable_problem(seed, angle_rad):
    R, t, m, n = matches_of_all_kinds(seed)
    R, t = disturbed(R, t, seed, angle_rad)
    (expected,), (expected_inliers,) = RelativePoseProblem(m, n, THRESHOLD_RAD).costs(as_model(R, t)[None])
    cost, inliers = kernels.score(m, n, R, t, THRESHOLD_RAD, np.inf)
    assert cost == pytest.approx(expected, rel=1e-9)
    assert inliers == expected_inliers


@laws
@given(seed=SEEDS, share=st.floats(0, 2))
def test_only_what_costs_more_than_the_bound_is_given_up(seed, share):
    R, t, m, n = matches_of_all_kinds(seed)
    full = kernels.score(m, n, R, t, THRESHOLD_RAD, np.inf)
    answer = kernels.score(m, n, R, t, THRESHOLD_RAD, share * full[0])
    assert answer == full or (answer == (np.inf, 0) and full[0] > share * full[0])


@laws
@given(seed=SEEDS)
def test_giving_up_does_not_change_the_winner(seed):
    R, t, m, n = matches_of_all_kinds(seed)
    poses = [disturbed(R, t, seed + k, angle_rad) for k, angle_rad in enumerate([0.5, 0.02, 1e-3, 0.1, 1e-3, 2.0])]
    best, winner = np.inf, -1
    for k, pose in enumerate(poses):
        cost, _ = kernels.score(m, n, *pose, THRESHOLD_RAD, best)
        if cost < best:
            best, winner = cost, k
    costs = [kernels.score(m, n, *pose, THRESHOLD_RAD, np.inf)[0] for pose in poses]
    assert winner == np.argmin(costs)


def test_the_sequential_test_gives_up_bad_models_and_hardly_a_good_one():
    R, t, m, n = two_views(0, 300, noise_rad=0.0)
    rng = np.random.default_rng(0)

    def share_given_up(explained: float, trials: int) -> float:
        given_up = 0
        for _ in range(trials):
            wrong = rng.random(len(n)) >= explained
            seen = np.where(wrong[:, None], np.cross(np.cross(t, m @ R.T), n), n)  # across its epipolar line
            cost, _, _ = kernels._score(m, unit(seen), R, t, THRESHOLD_RAD, np.inf, 0.4, 0.1)
            given_up += not np.isfinite(cost)
        return given_up / trials

    # Ville: the likelihood ratio exceeds 100 with probability 0.01 at most; 0.013 is its deviation of 60 trials.
    assert share_given_up(0.4, 600) < 0.01 + 5 * np.sqrt(0.01 / 600)
    assert share_given_up(0.1, 100) > 0.9


# --- refinement ---


@laws
@given(seed=SEEDS, angle_rad=st.floats(0, 0.05), wrong=st.integers(0, 20), iterations=st.integers(0, 12))
def test_refinement_goes_the_way_of_the_readable_one(seed, angle_rad, wrong, iterations):
    R, t, m, n = two_views(seed, wrong=wrong)
    use = np.random.default_rng(seed).random(len(m)) < 0.8
    R0, t0 = disturbed(R, t, seed, angle_rad)
    expected_R, expected_t = refine_pose(R0, t0, m[use], n[use], THRESHOLD_RAD, iterations)
    model = kernels.refine_model(m, n, use, as_model(R0, t0), THRESHOLD_RAD, iterations)
    kernels.refine(m, n, use, R0, t0, THRESHOLD_RAD, iterations)
    # Where the last step changes the cost by rounding alone, one of them takes it and the other does not.
    assert expected_R == pytest.approx(R0, abs=1e-6)
    assert expected_t == pytest.approx(t0, abs=1e-5)
    assert model[:9].reshape(3, 3) == pytest.approx(R0, abs=1e-6)
    assert model[9:] == pytest.approx(t0, abs=1e-5)


@laws
@given(seed=SEEDS)
def test_refinement_is_never_worse_than_its_start_and_stays_a_pose(seed):
    _, _, m, n = two_views(seed, wrong=10)
    R, t = random_pose(seed)

    def robust_cost() -> float:
        r2, _ = kernels.residuals(m, n, R, t, THRESHOLD_RAD)
        return float(np.sum(r2 / (THRESHOLD_RAD**2 + r2)))

    before = robust_cost()
    kernels.refine(m, n, np.ones(len(m), bool), R, t, THRESHOLD_RAD, 20)
    assert robust_cost() <= before * (1 + 1e-9)
    assert_orthonormal(R)
    assert np.linalg.norm(t) == pytest.approx(1)


def test_no_match_to_use_leaves_the_pose_as_it_is():
    R, t, m, n = two_views(0)
    R_end, t_end = R.copy(), t.copy()
    kernels.refine(m, n, np.zeros(len(m), bool), R_end, t_end, THRESHOLD_RAD, 5)
    assert (R_end.tolist(), t_end.tolist()) == (R.tolist(), t.tolist())


@laws
@given(seed=SEEDS, angle_rad=st.floats(0, 0.02), wrong=st.integers(0, 20))
def test_the_rotation_that_fits_is_that_of_the_readable_refinement(seed, angle_rad, wrong):
    R, _, m, _ = two_views(seed)
    rng = np.random.default_rng(seed)
    n = unit(m @ R.T + NOISE_RAD * rng.normal(size=m.shape))
    n[:wrong] = unit(rng.uniform([-0.5, -0.5, 1], [0.5, 0.5, 1], (wrong, 3)))
    found, _ = disturbed(R, np.ones(3), seed, angle_rad)
    expected = refine_rotation(found, m, n, 0.02, iterations=100)
    kernels.refine_rotation(m, n, found, 0.02, 100)
    assert distance(found, expected) < 1e-7
    assert_orthonormal(found)


@pytest.mark.parametrize("axis", [[np.pi, 0, 0], [0, np.pi, 0], [0, 0, np.pi], [0, 0, 0]])
def test_half_a_turn_and_none_are_rotations_too(axis):
    _, _, m, _ = two_views(0)
    R = rotation_from_vector(axis)
    found = rotation_from_vector([0.02, -0.03, 0.01]) @ R
    kernels.refine_rotation(m, m @ R.T, found, 0.1, 50)
    assert distance(found, R) < 1e-9


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_rays_for_a_rotation_leave_one(count):
    _, _, m, n = two_views(0)
    R = np.eye(3)
    kernels.refine_rotation(m[:count], n[:count], R, 0.5, 20)
    assert_orthonormal(R)
    assert m[:count] @ R.T == pytest.approx(n[:count], abs=1e-6)


# --- five matches ---

FIVE = np.arange(5)


def constraint(R, t, m, n) -> np.ndarray:
    """``n . (t x R m)``, zero where a match obeys the pose."""
    return np.einsum("ij,ij->i", n, np.cross(t, m @ R.T))


@settings(deadline=None, max_examples=200)
@given(seed=SEEDS, kind=st.sampled_from(["scene", "plane", "random rays", "all around"]))
def test_what_is_called_a_root_is_one(seed, kind):
    rng = np.random.default_rng(seed)
    if kind in ("scene", "plane"):
        _, _, m, n = two_views(seed, 5, planar=kind == "plane")
    else:
        m, n = (unit(rng.normal((0, 0, 3 * (kind == "random rays")), size=(5, 3))) for _ in range(2))
    for _ in range(10):
        R, t = np.eye(3), unit(rng.normal(size=3))
        if kernels.newton_five(m, n, FIVE, R, t):
            assert np.abs(constraint(R, t, m, n)).max() < 1e-7
            assert min(depth.min() for depth in depths_from_pose(R, t, m, n)) > 0
            assert_orthonormal(R)
            assert np.linalg.det(R) > 0
            assert np.linalg.norm(t) == pytest.approx(1)


@laws
@given(seed=SEEDS, planar=st.booleans(), sign=st.sampled_from([1, -1]))
def test_the_truth_is_found_from_near_it_whatever_the_sign_of_t(seed, planar, sign):
    R, t, m, n = two_views(seed, 5, noise_rad=0.0, planar=planar)
    singular = np.linalg.svd(sampson_jacobian(R, t, m, n)[1], compute_uv=False)
    assume(singular[-1] > 1e-4)  # else five matches hardly fix the pose
    R0, t0 = disturbed(R, t, seed, 0.02 * singular[-1])  # well within the distance to the next root
    t0 *= sign
    assert kernels.newton_five(m, n, FIVE, R0, t0)
    # A root is known to 1e-7 of its equations.
    assert distance(R0, R) < 1e-6 / singular[-1]
    assert t0 == pytest.approx(t, abs=1e-6 / singular[-1])


def test_one_start_in_ten_finds_the_truth():
    trials, found = 200, 0
    for seed in range(trials):
        truth, t_true, m, n = two_views(seed, 5, noise_rad=0.0)
        R, t = np.eye(3), unit(np.random.default_rng([seed, 2]).normal(size=3))
        found += kernels.newton_five(m, n, FIVE, R, t) and distance(R, truth) < 1e-4 and bool(t @ t_true > 0.999)
    assert found >= trials / 10


@laws
@given(seed=SEEDS, kind=st.sampled_from(["one match", "a match twice", "collinear", "no motion"]))
def test_matches_that_fix_no_pose_have_none(seed, kind):
    R_true, t_true, m, n = two_views(seed, 5, noise_rad=0.0)
    if kind == "one match":
        m, n = np.repeat(m[:1], 5, axis=0), np.repeat(n[:1], 5, axis=0)
    elif kind == "a match twice":
        m[4], n[4] = m[0], n[0]
    elif kind == "collinear":
        X = np.array([-1, 0.3, 5]) + np.arange(5)[:, None] * [0.5, 0.2, 0.3]
        m, n = unit(X), unit(X @ R_true.T + t_true)
    else:
        n = m.copy()
    R, t = np.eye(3), unit(np.random.default_rng(seed).normal(size=3))
    assert not kernels.newton_five(m, n, FIVE, R, t)


# --- samples ---


def searched(m, n, samples, seed: int = 0, size: int = 8):
    rng = np.random.default_rng(seed)
    rotations = np.stack([np.eye(3), rotation_from_vector([0.1, 0.0, -0.1])])
    directions = unit(rng.normal(size=(len(samples), 2, 3)))
    pool = np.zeros((size, 3, 3)), np.zeros((size, 3)), np.full(size, np.inf), np.zeros(size, np.int64)
    kernels.try_samples(m, n, samples, rotations, directions, THRESHOLD_RAD, *pool, np.zeros(2))
    return pool


@settings(deadline=None, max_examples=15)
@given(seed=SEEDS, wrong=st.integers(0, 60), size=st.integers(1, 8), planar=st.booleans())
def test_the_pool_holds_distinct_modes_in_order_with_their_costs(seed, wrong, size, planar):
    _, _, m, n = two_views(seed, 120, wrong=wrong, planar=planar)
    samples = draw_samples(np.random.default_rng(seed), len(m), 5, 150)
    R, t, costs, inliers = searched(m, n, samples, seed, size)
    filled = np.isfinite(costs)
    assert (costs[:-1] <= costs[1:]).all()
    for i in np.flatnonzero(filled):
        assert kernels.score(m, n, R[i], t[i], THRESHOLD_RAD, np.inf) == (costs[i], inliers[i])
        for j in range(i):
            assert kernels._mode_distance(R[i], t[i], R[j], t[j]) >= kernels._SAME_MODE_RAD


@pytest.mark.parametrize("seed", range(6))
def test_the_order_of_the_matches_means_nothing_to_the_best(seed):
    _, _, m, n = two_views(seed, 120, wrong=40)
    samples = draw_samples(np.random.default_rng(seed), len(m), 5, 200)
    # Sorted matches would be judged by the wrong ones alone, which come first.
    orders = [np.random.default_rng([seed, k]).permutation(len(m)) for k in range(2)]
    first, second = (searched(m[order], n[order], np.argsort(order)[samples]) for order in orders)
    assert second[2][0] == pytest.approx(first[2][0])
    assert second[0][0] == pytest.approx(first[0][0], abs=1e-9)
    assert second[1][0] == pytest.approx(first[1][0], abs=1e-9)
    assert second[3][0] == first[3][0]


def test_more_samples_never_make_the_best_worse():
    _, _, m, n = two_views(3, 120, wrong=60)
    order = np.random.default_rng(0).permutation(len(m))
    m, n = m[order], n[order]
    samples = draw_samples(np.random.default_rng(0), len(m), 5, 400)
    costs = [searched(m, n, samples[:count])[2][0] for count in (50, 100, 200, 400)]
    assert costs == sorted(costs, reverse=True)


def test_samples_without_a_solution_leave_the_pool_empty():
    _, _, m, n = two_views(0)
    m, n = (np.repeat(rays[:1], 60, axis=0) for rays in (m, n))
    samples = draw_samples(np.random.default_rng(0), len(m), 5, 50)
    assert np.isinf(searched(m, n, samples)[2]).all()


def test_what_is_only_read_is_not_written():
    R, t, m, n = two_views(0, wrong=10)
    samples = draw_samples(np.random.default_rng(0), len(m), 5, 50)
    use, model = np.ones(len(m), bool), as_model(R, t)
    read = (m, n, samples, use, model)
    before = [a.tobytes() for a in read]
    searched(m, n, samples)
    kernels.newton_five(m, n, samples[0], R.copy(), t.copy())
    kernels.residuals(m, n, R, t, THRESHOLD_RAD)
    kernels.refine(m, n, use, R.copy(), t.copy(), THRESHOLD_RAD, 5)
    kernels.refine_rotation(m, n, R.copy(), THRESHOLD_RAD, 5)
    kernels.refine_model(m, n, use, model, THRESHOLD_RAD, 5)
    assert [a.tobytes() for a in read] == before
    assert np.array_equal(R, two_views(0, wrong=10)[0])


@laws
@given(seed=SEEDS)
def test_the_compiled_problem_answers_as_the_readable_one(seed):
    R, t, m, n = matches_of_all_kinds(seed)
    readable, compiled = RelativePoseProblem(m, n, THRESHOLD_RAD), CompiledPoseProblem(m, n, THRESHOLD_RAD)
    models = np.stack([as_model(*disturbed(R, t, seed, angle_rad)) for angle_rad in (0.0, 1e-3, 0.1)])
    for ours, theirs in zip(compiled.costs(models), readable.costs(models), strict=True):
        assert ours == pytest.approx(theirs, rel=1e-9)
    assert (compiled.explained(models[1], 1e-3) == readable.explained(models[1], 1e-3)).all()
    ours, theirs = compiled.polish(models[1]), readable.polish(models[1])
    assert matrix_from_quaternion(ours[:4]) == pytest.approx(matrix_from_quaternion(theirs[:4]), abs=1e-6)
    assert ours[4:] == pytest.approx(theirs[4:], abs=1e-5)


# --- the compiler ---

_ESTIMATE = """
import sys
import numpy as np
import quest
assert "numba" not in sys.modules
rng = np.random.default_rng(0)
X = rng.uniform([-1, -1, 2], [1, 1, 6], (60, 3))
Y = X + [0.5, 0.1, 0.0] + 1e-3 * rng.normal(size=X.shape)
Y[:6] = rng.uniform([-1, -1, 2], [1, 1, 6], (6, 3))
pose = quest.estimate_relative_pose(X, Y, seed=1)
numba = sys.modules["numba"]
print(numba.config.DISABLE_JIT, pose.kind, pose.inliers.sum(), *pose.q_wxyz, *pose.t)
"""


def test_without_compilation_the_result_is_the_same():
    answers = []
    for disabled in ("0", "1"):
        environment = os.environ | {"NUMBA_DISABLE_JIT": disabled}
        done = subprocess.run(
            [sys.executable, "-W", "error::RuntimeWarning", "-c", _ESTIMATE],
            env=environment, capture_output=True, text=True, check=True, timeout=300,
        )  # fmt: skip
        answers.append(done.stdout.split())
    assert [answer[0] for answer in answers] == ["0", "1"]
    assert answers[1][1:3] == answers[0][1:3]
    assert np.array(answers[1][3:], float) == pytest.approx(np.array(answers[0][3:], float), abs=1e-9)


def test_where_no_folder_can_be_written_each_process_compiles(tmp_path):
    package = tmp_path / "quest"
    shutil.copytree(Path(kernels.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__", "benchmarks"))
    (package / "__pycache__").touch()  # a file is no folder
    nowhere = str(package / "__pycache__" / "nowhere")
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= dict.fromkeys(("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA"), nowhere)
    code = "import numpy; from quest import kernels; print(kernels.__file__, kernels._tangents(numpy.eye(3)[2])[:3])"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split(maxsplit=1)[0] == str(package / "kernels.py")


@given(first=st.floats(1, 1e5), later=st.floats(1, 100), other=st.floats(1, 1000))
def test_the_break_even_is_the_first_number_of_calls_that_pays(first, later, other):
    calls = break_even(first, later, other)

    def pays(k: float) -> bool:
        return first + (k - 1) * later <= k * other

    if calls == np.inf:
        assert later >= other
        assert not pays(1)
    else:
        assert first + (calls - 1) * later <= calls * other * (1 + 1e-12)
        assert calls == 1 or not pays(calls - 1)


def test_the_table_of_first_calls_takes_medians_and_shows_both_states_of_the_disk():
    cold = [{"numpy": 1.0, "quest": 2.0, "first": first, "later": 10.0, "quest6": 60.0} for first in (1e9, 1010.0, 0.0)]
    rows = table(cold, [run | {"first": 60.0} for run in cold]).splitlines()
    assert [cell.strip() for cell in rows[2].strip("| ").split("|")][1:] == [
        "1.0",
        "2.0",
        "1010.0",
        "10.0",
        "60.0",
        "20",
    ]
    assert rows[3].split("|")[-2].strip() == "1"
