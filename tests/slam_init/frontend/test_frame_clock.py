"""The times of a stream: converted as they come, and refused without any effect."""

from dataclasses import replace

import numpy as np
import pytest

from slam_init.config import Config
from slam_init.errors import SlamInitError
from slam_init.initializer import Initializer
from slam_init.methods import make_initializer
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.time_stamps import TimeUnit

TIMES_S = (100.25, 100.3, 100.35, 100.4)
DATES_S = (1403636579.75, 1403636579.8, 1403636579.85, 1403636579.9)
IMAGE = np.zeros((48, 64), np.uint8)
CAMERA = Camera("pinhole", 64, 48, 60, 60, 31.5, 23.5)


@pytest.mark.parametrize(("method", "times_s"), [("quest", TIMES_S), ("quest", DATES_S), ("orb-slam3", DATES_S)])
@pytest.mark.parametrize("unit", TimeUnit)
def test_the_online_api_converts_each_unit_and_reports_it(unit, method, times_s):
    initializer = make_initializer(method, CAMERA, Config())
    for time_s in times_s:
        initializer.process(IMAGE, round(time_s * unit.per_second, 3))
    np.testing.assert_allclose([seen.timestamp_s for seen in initializer.history], times_s, atol=2e-3, rtol=0)
    notes = [note for note in initializer.finish().notes if "time stamps" in note]
    assert bool(notes) == (unit != TimeUnit.SECONDS) and all(unit in note for note in notes)


def test_images_without_times_have_their_index_as_their_time():
    initializer = Initializer(CAMERA)
    for _ in range(3):
        initializer.process(IMAGE)
    assert [seen.timestamp_s for seen in initializer.history] == [0, 1, 2]
    assert not [note for note in initializer.finish().notes if "time stamps" in note]


def test_frames_of_a_source_some_seconds_apart_stay_in_seconds():
    initializer = Initializer(CAMERA)
    for index, time_s in enumerate((0.0, 60.0, 61.0)):
        initializer.process(Frame(index, time_s, f"{index}", IMAGE))
    assert [seen.timestamp_s for seen in initializer.history] == [0, 60, 61]


@pytest.mark.parametrize("time_s", [1.4e18, -1.0, float("nan"), 1.0])
def test_tracks_whose_time_is_no_second_are_refused(time_s):
    donor = Initializer(CAMERA)
    donor.process(IMAGE, 1.0)
    (seen,) = donor.history
    initializer = Initializer(CAMERA)
    initializer.process_tracks(seen)
    with pytest.raises(SlamInitError, match="time stamp"):
        initializer.process_tracks(replace(seen, frame=1, timestamp_s=time_s))
    assert initializer.process_tracks(replace(seen, frame=1, timestamp_s=2.0)) is initializer.status
