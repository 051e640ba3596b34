"""Laws of what the view of the map draws: the dashes of the true path, and the scale bar."""

import numpy as np
import pytest

from slam_init.recording.map_view import dashes, round_length


def test_the_dashes_have_equal_lengths_and_keep_the_corners_of_the_path():
    corner = np.array([[0.0, 0, 0], [3, 0, 0], [3, 4, 0]])
    drawn = dashes(corner)
    lengths = [np.linalg.norm(np.diff(dash, axis=0), axis=1).sum() for dash in drawn]
    np.testing.assert_allclose(lengths, 7 / (2 * len(drawn) - 1))
    assert np.isfinite(np.concatenate(dashes(np.zeros((3, 3))))).all()


def test_the_length_of_a_bar_is_round_and_the_longest_that_fits():
    for most, length in ((1.0, 1.0), (0.975, 0.5), (5.0, 5.0), (0.025, 0.02), (250.0, 200.0), (2.0, 2.0)):
        assert round_length(most) == pytest.approx(length)
