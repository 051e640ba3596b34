"""Synthetic sequences as a source, rendered or as tracks without images."""

import numpy as np
import pytest

from sequences_synth import PointOptions, SynthOptions, make_points, make_sequence, write_tum
from slam_init.datasets import open_source
from slam_init.datasets.synth import open_points
from slam_init.errors import SourceError


def test_a_synthetic_source_equals_the_folder_written_from_it(tmp_path):
    write_tum(make_sequence("room", 2, SynthOptions(frames=3, width=96, height=64)), tmp_path / "s")
    read, made = (open_source(str(tmp_path / "s")), open_source("synth:room?frames=3&width=96&height=64", seed=2))
    assert read.camera == made.camera
    for a, b in zip(read.frames(), made.frames(), strict=True):
        np.testing.assert_array_equal(a.image, b.image)
        true_a, true_b = read.groundtruth.at(a.timestamp_s), made.groundtruth.at(b.timestamp_s)
        np.testing.assert_allclose(true_a.R, true_b.R, atol=1e-7)
        np.testing.assert_allclose(true_a.t, true_b.t, atol=1e-7)


def test_an_option_of_earlier_versions_names_what_to_use_and_a_switch_is_0_or_1():
    for text, message in (
        ("synth:room?lens=omni", "use one of pinhole, radtan, fisheye"),
        ("synth:room?imu=yes", "give 0 or 1"),
    ):
        with pytest.raises(SourceError, match=message):
            open_source(text)


# -- tracks without images -------------------------------------------------------------------------


def test_a_source_of_points_gives_the_tracks_of_the_sequence():
    source = open_points("points:wall?views=4&noise_px=0.3", 2)
    sequence = make_points("wall", 2, PointOptions(views=4, noise_px=0.3))
    assert (source.name, source.kind, len(source)) == ("wall", "points", 4)
    for index, observations in enumerate(source.observations()):
        np.testing.assert_array_equal(observations.track_ids, np.flatnonzero(sequence.visible[index]))
        np.testing.assert_array_equal(observations.pixels, sequence.pixels[index, sequence.visible[index]])
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
    with pytest.raises(SourceError):
        open_points(text, 0)
