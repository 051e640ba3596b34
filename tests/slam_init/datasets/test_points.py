"""Tracks without images as a source."""

import numpy as np
import pytest

from sequences_synth import PointOptions, make_points
from slam_init.datasets.synth import open_points
from slam_init.errors import SourceError


def test_a_source_of_points_gives_the_tracks_of_the_sequence():
    source = open_points("points:wall?views=4&noise_px=0.3", 2)
    sequence = make_points("wall", 2, PointOptions(views=4, noise_px=0.3))
    assert (source.name, source.kind, len(source)) == ("wall", "points", 4)
    for index, observations in enumerate(source.observations()):
        track_ids, pixels = sequence.observe(index)
        np.testing.assert_array_equal(observations.track_ids, track_ids)
        np.testing.assert_array_equal(observations.pixels, pixels)
    assert [frame.index for frame in source.frames(1, 2)] == [1, 2]


@pytest.mark.parametrize(
    "text",
    [
        "points:attic",
        "points:room?colour=1",
        "points:room?views=many",
        "points:room?outliers=2",
        "points:tilted-20",
        "points:room?stabilized=1",
        "points:room?readout_direction=inwards",
        "points:room?fps=30&readout_ms=50",
    ],
)
def test_an_invalid_source_text_is_refused_in_one_line(text):
    with pytest.raises(SourceError) as caught:
        open_points(text, 0)
    assert "\n" not in str(caught.value)
