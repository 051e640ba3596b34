"""The benchmark of samples of six: its samples obey their pose, and its command writes the four tables."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quest.geometry.epipolar import depths_from_pose, sampson_error
from quest.geometry.quaternion import rotation_angle
from tests.benchmarks.quest import six_matches
from tests.benchmarks.quest.six_matches import SAMPLES, draw_sample, main, poses_by_six


@settings(max_examples=30)
@given(kind=st.sampled_from(list(SAMPLES)), seed=st.integers(0, 2**32 - 1))
def test_exact_samples_obey_their_pose_with_all_points_in_front(kind, seed):
    m, n, R, t = draw_sample(kind, np.random.default_rng(seed), 0.0)
    assert np.abs(sampson_error(R, t, m, n)).max() < 1e-12
    assert min(depths.min() for depths in depths_from_pose(R, t, m, n)) > 0
    angle = np.degrees(rotation_angle(R))
    assert SAMPLES[kind].least_deg - 1e-5 <= angle <= SAMPLES[kind].most_deg + 1e-5


@pytest.mark.parametrize("kind", list(SAMPLES))
def test_the_compiled_solver_misses_no_exact_sample(kind):
    rng = np.random.default_rng(1)
    for _ in range(50):
        m, n, R, t = draw_sample(kind, rng, 0.0)
        errors = [
            rotation_angle(found @ R.T) + np.linalg.norm(direction - t) for found, direction in poses_by_six(m, n, rng)
        ]
        assert min(errors) < 1e-6


def test_the_command_writes_all_tables(tmp_path, monkeypatch):
    monkeypatch.setattr(six_matches, "_BLOCK", 5)
    monkeypatch.setattr(six_matches, "_BLOCKS", 1)
    main(["--problems", "2", "--trials", "1", "--matches", "60", "--out", str(tmp_path)])
    text = (tmp_path / "six_matches.md").read_text()
    assert text.count("\n## ") == 4
    assert all(f"| {kind} " in text for kind in SAMPLES)
