"""One suite for all solvers of the relative rotation: exactness by kind of scene, laws, degenerate samples."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_views import SCENES, distance, scene_points, two_views, unit

from quest.errors import InputError
from quest.geometry.quaternion import conjugate, matrix_from_quaternion, multiply
from quest.paper.newton import polish_on_matches
from quest.paper.quest6_fast import quest6_fast
from quest.paper.selection import select_candidates
from tests.benchmarks.quest.paper_problems import draw_problems, rotation_error
from tests.benchmarks.quest.solvers import SOLVERS, Solver

ALL = pytest.mark.parametrize("solver", SOLVERS.values(), ids=SOLVERS)
SEEDS = st.integers(0, 2**32 - 1)


def sample(solver: Solver, seed: int, q, t):
    """A sample of the kind that a solver is exact for."""
    return two_views(scene_points(seed, solver.sample_size, coplanar=not solver.handles_depth), unit(q), t)


def known(q: np.ndarray) -> np.ndarray:
    return q[np.isfinite(q[..., 0])]


# --- exact data ---


@ALL
@pytest.mark.parametrize("scene", SCENES)
def test_points_of_the_kind_that_a_solver_claims_are_solved_exactly(solver: Solver, scene: str):
    q, t = SCENES[scene]
    counts = (solver.sample_size, 10) if solver.takes_more and scene == "general" else (solver.sample_size,)
    for coplanar in [kind for kind in (False, True) if (solver.handles_planes if kind else solver.handles_depth)]:
        for seed in range(5):
            for count in counts:
                m, n = two_views(scene_points(seed, count, coplanar=coplanar), unit(q), t)
                assert distance(solver.function(m, n), unit(q)) < 1e-6


@ALL
@pytest.mark.parametrize("scene", ["general", "identity", "half turn about x"])
def test_a_rotation_only_camera_gives_its_rotation_alone(solver: Solver, scene: str):
    q = unit(SCENES[scene][0])
    m, n = two_views(scene_points(0, solver.sample_size), q, [0, 0, 0])
    found = solver.function(m, n)
    # Up to its sign, which is a matter of rounding at a half turn.
    assert len(found) == 1
    assert distance(found, q) < 1e-12


@ALL
@pytest.mark.parametrize("t", [[0, 0, 0], [1e-7, 0, 0], [1e-4, 0, 1e-4], [0, 0, 0.5]])
@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-3])
def test_weak_translations_give_unit_quaternions_or_nothing(solver: Solver, t, noise: float):
    rng = np.random.default_rng(0)
    m, n = sample(solver, 0, [1, 0, 0, 0], t)
    n = unit(n + noise * rng.normal(size=n.shape))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        q = solver.function(m, n)
    assert np.linalg.norm(q, axis=1) == pytest.approx(np.ones(len(q)))


# --- laws ---


@ALL
@settings(max_examples=10)
@given(seed=SEEDS)
def test_swapping_permuting_rotating_and_scaling_act_as_they_should(solver: Solver, seed: int):
    rng = np.random.default_rng(seed)
    q, t = unit([1.0, *rng.uniform(-0.3, 0.3, 3)]), unit(rng.normal(size=3))
    m, n = sample(solver, seed, q, t)
    p = unit(rng.normal(size=4))
    P = matrix_from_quaternion(p)
    order = rng.permutation(len(m))
    solve = solver.function
    assert distance(solve(n, m), conjugate(q)) < 1e-4, "swapping the views inverts the rotation"
    assert distance(solve(m[order], n[order]), q) < 1e-4, "the order of the matches is irrelevant"
    assert distance(solve(m, n @ P.T), multiply(p, q)) < 1e-4, "rotating camera 2 composes from the left"
    assert distance(solve(m @ P.T, n), multiply(q, conjugate(p))) < 1e-4, "rotating camera 1 composes from the right"
    assert distance(solve(3 * m, 0.2 * n), q) < 1e-4, "the norm of a ray is irrelevant"


@ALL
def test_a_batch_equals_its_samples_one_by_one(solver: Solver):
    p = draw_problems(np.random.default_rng(0), 6, solver.sample_size, 1.0, coplanar=not solver.handles_depth)
    batch = solver.function(p.m, p.n)
    assert batch.ndim == 3
    for q, m, n in zip(batch, p.m, p.n, strict=True):
        single = solver.function(m, n)
        assert known(q).shape == single.shape
        # In any order, since rounding changes the order of eigenvalues.
        assert max(distance(single, one) for one in known(q)) < 1e-6


@ALL
def test_candidates_are_canonical_unit_quaternions_and_no_more_than_stated(solver: Solver):
    p = draw_problems(np.random.default_rng(1), 50, solver.sample_size, 2.0, coplanar=not solver.handles_depth)
    q = solver.function(p.m, p.n)
    assert np.isfinite(q[..., 0]).sum(axis=1).max() <= solver.most_candidates
    assert np.array_equal(np.isfinite(q).any(axis=-1), np.isfinite(q).all(axis=-1))
    assert np.linalg.norm(known(q), axis=-1) == pytest.approx(np.ones(len(known(q))))
    assert (known(q)[:, 0] >= 0).all()
    assert q.tobytes() == solver.function(p.m, p.n).tobytes()


# --- degenerate samples and wrong input ---


@ALL
@pytest.mark.parametrize("distinct", [1, 2, 3, 4, 5])
def test_repeated_matches_neither_raise_nor_warn_nor_change_other_samples(solver: Solver, distinct: int):
    q, t = SCENES["general"]
    m, n = sample(solver, 0, q, t)
    repeated = np.arange(len(m)) % distinct
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        both = np.stack([m[repeated], m]), np.stack([n[repeated], n])
        batch = solver.function(*both)
        chosen, _ = select_candidates(batch, *both)
    assert distance(known(batch[1]), unit(q)) < 1e-6
    assert distance(known(chosen[1]), unit(q)) < 1e-6


@ALL
def test_wrong_arguments_are_named(solver: Solver):
    good, more = np.ones((solver.sample_size, 3)), np.ones((solver.sample_size + 1, 3))
    wrong = [
        (good[1:], good[1:], f"at least {solver.sample_size}"),
        (good, good[None], "one shape"),
        (good[:, :2], good[:, :2], "one shape"),
        (good, np.nan * good, "not finite"),
        (good, 0 * good, "zero"),
    ]
    for m, n, message in wrong if solver.takes_more else [*wrong, (more, more, "give")]:
        with pytest.raises(InputError, match=message):
            solver.function(m, n)
    if solver.function is quest6_fast:
        with pytest.raises(InputError, match="polish"):
            quest6_fast(good, good, polish=1.5)


# --- QuEst in the null space ---


@pytest.mark.parametrize("coplanar", [False, True])
def test_the_deflated_problem_contains_every_motion_of_exact_data(coplanar: bool):
    # The other rotation of the twisted pair, R' = (2 t t' - 1) R, has the same epipolar planes.
    q, t = unit(SCENES["general"][0]), unit(SCENES["general"][1])
    second = multiply([0.0, *t], q)
    m, n = two_views(scene_points(0, 6, coplanar=coplanar), q, t)
    for polish in (0, 1):
        candidates = quest6_fast(m, n, polish=polish)
        assert distance(candidates, q) < 1e-6
        assert distance(candidates, second) < 1e-6


def test_each_refinement_step_squares_the_error_and_an_error_of_zero_stays():
    p = draw_problems(np.random.default_rng(0), 50, 8, 0.0)
    off = unit(p.q + 1e-3 * np.random.default_rng(1).normal(size=p.q.shape))[:, None]
    errors = [np.median(rotation_error(polish_on_matches(off, p.m, p.n, steps), p.q)) for steps in (0, 1, 2)]
    assert errors[1] < 0.1 * errors[0]
    assert errors[2] < 0.01 * errors[1]
    assert rotation_error(polish_on_matches(p.q[:, None], p.m, p.n, 3), p.q).max() < 1e-12
    assert np.isnan(polish_on_matches(np.full((50, 2, 4), np.nan), p.m, p.n, 1)).all()


# --- the accuracy aimed at ---


def test_under_noise_the_first_of_quest6_fast_is_more_accurate_than_that_of_the_five_point_solver():
    # Means of 200 problems at 0.5 px: .033 and .13; with all six points for the ranking of the 5-point, .046.
    p = draw_problems(np.random.default_rng(3), 200, 6, 0.5)

    def first(name: str, count: int) -> float:
        candidates = SOLVERS[name].function(p.m[:, :count], p.n[:, :count])
        return float(rotation_error(select_candidates(candidates, p.m[:, :count], p.n[:, :count], 1)[0], p.q).mean())

    assert first("quest6_fast", 6) < 0.5 * first("five_point", 5)
