"""Poses, alignments and readers give rotations, or refuse with a reason."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotations import is_rotation

from quest.geometry.quaternion import rotation_from_vector
from slam_init.errors import SlamInitError
from slam_init.evaluation.metrics import align_poses, align_positions
from slam_init.types.pose import Pose


@pytest.mark.parametrize("q", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 0]])
def test_a_quaternion_that_is_no_rotation_is_refused(q):
    with pytest.raises(SlamInitError, match="no rotation"):
        Pose.from_quaternion(q, [0, 0, 0])


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(["equal", "collinear", "planar", "general", "mirrored"]))
def test_alignments_of_degenerate_positions_are_rotations(seed, kind):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 8))
    source, target = rng.normal(size=(2, count, 3))
    if kind == "mirrored":
        target = source * [1, 1, -1]
    rank = {"equal": 0, "collinear": 1, "planar": 2}.get(kind, 3)
    source[:, rank:] = 0.0
    assert is_rotation(align_positions(source, target).R)
    assert is_rotation(align_positions(target, source).R)
    poses = [Pose(rotation_from_vector(np.pi * w), t) for w, t in zip(source, target, strict=True)]
    assert is_rotation(align_poses(poses, poses[::-1]).R)
