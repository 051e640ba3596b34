"""The example that feeds the initializer with its own features and matches."""

import own_tracks
import pytest

from slam_init.compare.measures import pose_errors

pytestmark = pytest.mark.process


def test_the_map_from_orb_tracks_is_correct(room):
    result = own_tracks.initialize_from_tracks(room.camera, room.frames(0, 40))
    assert result
    errors = pose_errors(result.map, room.groundtruth)
    assert errors.rotation_deg < 5
    assert errors.direction_deg < 15
