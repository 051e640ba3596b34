"""Synthetic sequences as a source."""

import numpy as np
import pytest

from sequences_synth import SynthOptions, make_sequence, write_tum
from slam_init.datasets import open_source
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
