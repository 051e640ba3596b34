"""Frozen suites: worlds that never change."""

import pytest

from slam_init.compare.replay import replay, tracks_digest
from slam_init.compare.sources import open_compared
from slam_init.compare.suites import SUITES

#: Digests of the tracks of some worlds of the suite ``simulated`` as they were frozen.
FROZEN = {0: "462b0b3998e81943", 1: "295ee4652ef771ce", 5: "da366fabfe9ad2b3", 9: "4219f325a7baa9da"}


def test_the_tracks_of_the_worlds_are_the_frozen_ones():
    for world, digest in FROZEN.items():
        text = SUITES["simulated"].worlds[world]
        source = open_compared(text)
        assert tracks_digest(source, text, replay(source, text, 0, "")) == digest


@pytest.mark.parametrize("suite", SUITES)
def test_other_tracks_are_reported(suite):
    digests = ["0" * 16] * len(SUITES[suite].worlds)
    assert "runs on this machine only" in SUITES[suite].verdict(digests)
