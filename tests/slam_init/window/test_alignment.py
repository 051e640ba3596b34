"""The alignment of a view begins with the proposed rotation."""

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.window.locating import align_with_first


def test_a_proposal_finds_a_turn_that_is_too_large_for_a_start_without_one():
    rng, turn = np.random.default_rng(0), rotation_from_vector([0.0, 2.5, 0.0])
    rays = np.column_stack([rng.uniform(-0.5, 0.5, (80, 2)), np.ones(80)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    seen, found = np.stack([rays, rays @ turn.T]), np.tile(np.eye(3), (2, 1, 1))
    align_with_first(seen, found)
    assert np.abs(found[1] - turn).max() > 0.1
    found[1] = rotation_from_vector([0.0, 2.4, 0.0])
    align_with_first(seen, found)
    np.testing.assert_allclose(found[1], turn, atol=1e-9)
