"""The compiled optimizer of the joint fit: what was measured has its gradient, and its parts solve what they say."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import PRIORS, make_window

from quest.geometry.quaternion import rotation_from_vector
from slam_init.window.arguments import Equations, Room
from slam_init.window.equations import WindowEquations
from slam_init.window.kernel import turn_between
from slam_init.window.optimizer import solve_damped


def window_and_start(views, *, measured=False):
    window = make_window("room", 5, views, noise_px=0.7)
    tracks, start = window.tracks, window.start(5)
    if measured:
        weights = np.full(views, 1e4)
        weights[0] = 0
        tracks = replace(tracks, turned=window.R, turned_weights=weights)
    return tracks, start


@pytest.mark.parametrize("angle", [1e-9, 0.01, 0.1])
def test_the_gradient_of_what_was_measured_is_the_slope_of_its_cost(angle):
    tracks, start = window_and_start(3, measured=True)
    none = replace(tracks, turned_weights=np.zeros(3))

    def turned(by):
        R = tracks.turned.copy()
        R[2] = by @ R[2]
        return replace(start, R=R)

    def cost(by):
        state = turned(by)
        costs = [WindowEquations(one, state, PRIORS).cost(state) for one in (tracks, none)]
        return costs[0] - costs[1]

    at, step = angle * np.array([0.6, 0.0, 0.8]), 1e-5
    gradient = WindowEquations(tracks, start, PRIORS).prior_gradient(turned(rotation_from_vector(at)))
    np.testing.assert_allclose(gradient[:6], 0, atol=1e-9)
    for axis in np.eye(3):
        ahead, behind = (cost(rotation_from_vector(s * step * axis) @ rotation_from_vector(at)) for s in (1, -1))
        slope = (ahead - behind) / (4 * step)
        # A rotation vector of half a radian is not yet a turn about its axes: its gradient is that of small angles.
        assert gradient[6:9] @ axis == pytest.approx(slope, rel=0.1, abs=0.1 + 60 * angle)


@pytest.mark.parametrize("pivot", [-1.0, np.nan])
def test_equations_that_have_no_minimum_give_no_step(pivot):
    equations = Equations.empty(0, 0, 0, 2)
    equations.normal[:] = np.diag([1.0, pivot])
    assert not solve_damped(equations, 0.0, Room.empty(2))


@pytest.mark.parametrize("angle", [0.0, 1e-13, 1e-6, 0.3, 3.1])
def test_the_turn_between_two_rotations_is_the_logarithm_of_their_quotient(angle):
    rng = np.random.default_rng(3)
    for _ in range(20):
        one, axis = rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)
        vector = angle * axis / np.linalg.norm(axis)
        R = np.stack([np.eye(3), rotation_from_vector(vector) @ one])
        found = turn_between(R, np.stack([np.eye(3), one]), 1)
        np.testing.assert_allclose(found, vector, atol=1e-12)
