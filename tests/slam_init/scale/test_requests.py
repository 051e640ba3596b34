"""The text of a known length, and what is refused. The command line tests the messages."""

import pytest

from slam_init.errors import ConfigError
from slam_init.scale.requests import (
    CameraHeight,
    KnownBoard,
    KnownDistance,
    KnownLength,
    KnownMarkers,
    MeasuredMotion,
    TrueTrajectory,
    parse_scale,
)


def test_a_text_says_what_is_known():
    for text, request in (
        ("marker:tag36h11:0.14", KnownMarkers("tag36h11", KnownLength(0.14))),
        ("marker:DICT_4X4_50:0.14+-0.001", KnownMarkers("DICT_4X4_50", KnownLength(0.14, 0.001))),
        ("board:9x6:0.025", KnownBoard(9, 6, KnownLength(0.025))),
        ("height:1.65", CameraHeight(KnownLength(1.65))),
        ("height:40+-2,nadir", CameraHeight(KnownLength(40, 2), nadir=True)),
        ("distance:0.25", KnownDistance(KnownLength(0.25))),
        ("distance:0.25,10,40", KnownDistance(KnownLength(0.25), (10, 40))),
        ("groundtruth", TrueTrajectory()),
        ("imu", MeasuredMotion()),
    ):
        assert parse_scale(text) == request
        assert request.origin == text.partition(":")[0]


@pytest.mark.parametrize(
    "text",
    [
        "", ":", "marker", "marker:", "marker:tag36h11", "marker::0.1", "marker:nothing:0.1", "marker:tag36h11:0",
        "board:9:0.1", "board:9x6", "board:2x6:0.1", "board:9x999999999999999:0.1", "height", "height:nan",
        "height:inf", "height:1e9", "height:1.65,up", "distance:", "distance:1,2", "distance:1,40,10",
        "distance:1,-1,3", "distance:1,a,b", "groundtruth:1", "1.65", "height:1+-1",
        "height:1+--1", "height:" + "9" * 5000,
    ],
)  # fmt: skip
def test_another_text_is_refused_in_one_line(text):
    with pytest.raises(ConfigError) as caught:
        parse_scale(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500
