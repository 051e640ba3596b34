"""The scale in a recording: a bar of a round length; a restart clears the lost map."""

import pytest
from make_map import CAMERAS, make_map, make_observations
from read_recording import column, entities

from slam_init.recording.map_view import round_length
from slam_init.recording.rerun_recorder import RerunRecorder
from slam_init.types.scale import Scale, ScaleOrigin


@pytest.mark.parametrize(
    ("metres_per_unit", "metres"), [(4.0, 1.0), (3.9, 0.5), (20.0, 5.0), (0.1, 0.02), (1000.0, 200.0), (8.0, 2.0)]
)
def test_the_bar_is_round_and_at_most_a_quarter_of_the_unit(metres_per_unit, metres):
    assert round_length(0.25 * metres_per_unit) == pytest.approx(metres)


def test_a_recording_shows_the_scale_and_clears_a_lost_map(tmp_path):
    map_, path = make_map(), tmp_path / "recording.rrd"
    with RerunRecorder(path, CAMERAS["pinhole"], "arc") as recorder:
        recorder.initialized(map_, make_observations(map_))
        recorder.scaled(Scale(ScaleOrigin.HEIGHT, 4.0, 0.02))
        recorder.restarted()
    (labels,) = [label for label in column(path, "/world/scale", "LineStrips3D:labels") if label]
    assert labels[0].startswith("1 m (1 unit = 4 m +- 2.0%")
    assert "/world/keyframes" in entities(path)
