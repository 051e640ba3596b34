"""The dashed path of the ground truth."""

import numpy as np

from slam_init.recording.map_view import dashes


def test_the_dashes_have_equal_lengths_and_keep_the_corners_of_the_path():
    corner = np.array([[0.0, 0, 0], [3, 0, 0], [3, 4, 0]])
    drawn = dashes(corner)
    lengths = [np.linalg.norm(np.diff(dash, axis=0), axis=1).sum() for dash in drawn]
    np.testing.assert_allclose(lengths, 7 / (2 * len(drawn) - 1))
    assert np.isfinite(np.concatenate(dashes(np.zeros((3, 3))))).all()
