"""A rotation is a rotation: ``R R^T = 1`` and ``det R = 1`` to 1e-9 on degenerate rays, or a refusal with a reason."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotations import FUNCTIONS, is_rotation

import quest
from quest.geometry.quaternion import matrix_from_quaternion, quaternion_from_matrix, rotation_from_vector
from quest.robust.rotation import fit_rotation, refine_rotation

# No division by zero and no overflow is allowed in the arithmetic.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


def general(rng, count):
    X = rng.uniform([-1, -1, 1], [1, 1, 4], (count, 3))
    R, t = rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)
    return X, X @ R.T + t, R, t


def clusters(rng, count, spread=0.0):
    return rng.normal(size=(2, 3))[np.arange(count) % 2] + spread * rng.normal(size=(count, 3))


def at_epipoles(rng, count):
    X, Y, R, t = general(rng, count)
    X[: count // 2], Y[: count // 2] = -R.T @ t, t
    return X, Y


#: By name: two views (N, 3) that determine no motion, or hardly one.
RAYS = {
    "all equal": lambda rng, count: [np.tile(rng.normal(size=3), (count, 1)) for _ in range(2)],
    "all opposite": lambda rng, count: [sign * np.ones((count, 3)) for sign in (1, -1)],
    "two clusters": lambda rng, count: [clusters(rng, count) for _ in range(2)],
    "two tight clusters": lambda rng, count: [clusters(rng, count, 1e-12) for _ in range(2)],
    "nearly equal": lambda rng, count: [np.ones(3) + 1e-9 * rng.normal(size=(count, 3)) for _ in range(2)],
    "collinear": lambda rng, count: [rng.normal(size=(count, 2)) @ rng.normal(size=(2, 3)) for _ in range(2)],
    "antipodal": lambda rng, count: [(X := general(rng, count)[0]), -X],
    "opposite pairs": lambda rng, count: [rng.choice([-1.0, 1.0], (count, 1)) * np.ones(3) for _ in range(2)],
    "at the epipoles": at_epipoles,
    "axes": lambda rng, count: [np.eye(3)[rng.integers(0, 3, count)] for _ in range(2)],
    "unrelated": lambda rng, count: [rng.normal(size=(count, 3)) for _ in range(2)],
    "large": lambda rng, count: [1e307 * rays for rays in general(rng, count)[:2]],
    "tiny": lambda rng, count: [1e-307 * rays for rays in general(rng, count)[:2]],
    "float32": lambda rng, count: [rays.astype(np.float32) for rays in general(rng, count)[:2]],
    "not contiguous": lambda rng, count: [np.repeat(rays, 2, axis=0)[::-2] for rays in general(rng, count)[:2]],
    "integers": lambda rng, count: [rng.integers(1, 9, (count, 3)) for _ in range(2)],
}


def rotations_of(result):
    """The rotations (K, 3, 3) in an answer; none in a refusal."""
    if isinstance(result, quest.RelativePose):
        return [result.R, *(other.R for other in result.alternatives)]
    if isinstance(result, quest.SharedFocal):
        return rotations_of(result.pose)
    if isinstance(result, list):
        return [R for one in result for R in rotations_of(one)]
    if isinstance(result, np.ndarray):
        return list(matrix_from_quaternion(result))
    return []


K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
#: The calls of the functions that take more than two views.
CALLS = {
    "estimate_relative_pose": lambda f, m, n: f(m, n, max_samples=50),
    "refine_relative_pose": lambda f, m, n: f(m, n, (np.eye(3), [1.0, 0.0, 0.0])),
    "estimate_relative_pose_px": lambda f, m, n: f(m[:, :2], n[:, :2], K, K, max_samples=50),
    "estimate_relative_poses": lambda f, m, n: f([(m, n)], max_samples=50),
    "estimate_upright_pose": lambda f, m, n: f(m, n, [0.0, 1.0, 0.0], [0.0, 1.0, 0.1], max_samples=50),
    "estimate_shared_focal": lambda f, m, n: f(m[:, :2], n[:, :2], (320.0, 240.0)),
}


def called(name, m, n):
    """The answer of a public function that gives a rotation."""
    return CALLS.get(name, lambda f, m, n: f(m, n))(FUNCTIONS[name], m, n)


#: Functions that take one number of matches only.
EXACT = {"quest5": 5, "five_point": 5, "quest6_fast": 6}
#: Functions that are given a rotation.
TAKING_ONE = ("parallax_statement", "translation_and_depths", "translation_and_depths_printed")
GIVING_ONE = pytest.mark.parametrize("name", [name for name in FUNCTIONS if name not in TAKING_ONE])


@GIVING_ONE
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(sorted(RAYS)), count=st.sampled_from([5, 6, 7, 8, 12, 30]))
def test_each_public_function_gives_rotations_or_refuses(name, seed, kind, count):
    m, n = RAYS[kind](np.random.default_rng(seed), EXACT.get(name, count))
    try:
        result = called(name, m, n)
    except quest.InputError as error:
        assert len(str(error).splitlines()) == 1
        return
    assert all(is_rotation(R) for R in rotations_of(result))


@GIVING_ONE
@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("view", [0, 1])
def test_one_row_without_meaning_is_refused(name, bad, view):
    views = list(general(np.random.default_rng(0), EXACT.get(name, 12))[:2])
    views[view][3] = bad
    with pytest.raises(quest.InputError):
        called(name, *views)


@GIVING_ONE
def test_views_are_not_changed_and_may_be_read_only(name):
    views = general(np.random.default_rng(0), EXACT.get(name, 12))[:2]
    before = [view.copy() for view in views]
    for view in views:
        view.setflags(write=False)
    called(name, *views)
    np.testing.assert_array_equal(views, before)


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(sorted(RAYS)), threshold_rad=st.sampled_from([1e-4, 2e-3, 1])
)
def test_a_fitted_rotation_is_one_even_where_no_pair_of_rays_determines_it(seed, kind, threshold_rad):
    rng = np.random.default_rng(seed)
    scaled = [np.asarray(rays, float) / np.abs(rays).max() for rays in RAYS[kind](rng, 12)]
    m, n = (rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in scaled)
    R, _ = fit_rotation(m, n, threshold_rad, rng)
    assert is_rotation(R)
    assert is_rotation(refine_rotation(R, m, n, threshold_rad))


@given(st.lists(st.floats(-1e308, 1e308, allow_subnormal=False), min_size=4, max_size=4).filter(any))
def test_quaternions_of_any_norm_but_zero_are_rotations(q):
    R = matrix_from_quaternion(q)
    assert is_rotation(R)
    assert is_rotation(matrix_from_quaternion(quaternion_from_matrix(R)))


@pytest.mark.parametrize("q", [[0, 0, 0, 0], [np.inf, 0, 0, 0], [[1, 0, 0, 0], [0, 0, 0, 0]]])
def test_a_quaternion_that_is_no_rotation_is_refused(q):
    with pytest.raises(quest.InputError):
        matrix_from_quaternion(q)
