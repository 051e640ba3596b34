"""Laws of the status and of the frames that are made from images."""

from dataclasses import fields, replace

import numpy as np
import pytest
from make_scene import CAMERA

from slam_init.errors import SlamInitError
from slam_init.initializer import Initializer
from slam_init.types.evidence import WindowEvidence
from slam_init.types.frame import Frame
from slam_init.types.refusal import Verdict
from slam_init.types.result import Attempt
from slam_init.types.status import State, Status, frame_of

WINDOW = WindowEvidence(**{field.name: 0 for field in fields(WindowEvidence)})


def test_a_status_takes_reason_and_advice_from_the_last_attempt():
    refused = Attempt((0, 1), Verdict.LOW_PARALLAX, "keep translating")
    status = Status().after(refused, 0.4)
    assert (status.state, status.reason, status.advice) == (State.WAITING, "low_parallax", "keep translating")
    assert (status.progress, status.attempt) == (0.4, refused)
    assert not status
    idle = status.after(None, 0.3)
    assert (idle.reason, idle.advice, idle.progress, idle.attempt) == ("low_parallax", "keep translating", 0.3, None)


def test_the_window_and_its_risk_stay_until_another_window_is_judged():
    windows = [replace(WINDOW, risk=risk) for risk in (0.4, 0.001)]
    attempts = [Attempt((0, k), Verdict.LOW_PARALLAX, window=window) for k, window in enumerate(windows, 1)]
    assert Status().risk is None
    status = Status().after(attempts[0], 0.4)
    assert status.risk == 0.4
    assert status.after(None, 0.3).after(Attempt((0, 2), Verdict.TOO_FEW_MATCHES), 0.2).window == windows[0]
    assert Status.initialized(attempts[1]).risk == 0.001


def test_a_status_with_a_map_is_truthy_and_has_no_reason():
    status = Status.initialized(None)
    assert status
    assert (status.state, status.progress, status.reason, status.advice) == ("initialized", 1.0, None, "")


def test_an_image_gets_the_next_index_and_a_frame_keeps_its_own():
    image = np.zeros((480, 640), np.uint8)
    assert (frame_of(image, None, 7, CAMERA).index, frame_of(image, None, 7, CAMERA).timestamp_s) == (7, 7.0)
    named = replace(frame_of(image, 0.5, 7, CAMERA), name="a.png")
    assert frame_of(named, None, 12, CAMERA) is named
    later = frame_of(named, 0.75, 12, CAMERA)
    assert (later.index, later.name, later.timestamp_s) == (7, "a.png", 0.75)


@pytest.mark.parametrize(
    ("image", "timestamp_s", "message"),
    [
        (np.zeros((480, 640)), None, "uint8"),
        (np.zeros((640, 480), np.uint8), None, "camera is for 640x480: if they are resized, .* cropped"),
        (np.zeros((480, 640, 4), np.uint8), None, "BGR"),
        (np.zeros((480, 640), np.uint8), float("nan"), "time stamp"),
        (np.zeros((480, 640), np.uint8), float("inf"), "time stamp"),
    ],
)
def test_an_array_that_is_not_an_image_is_refused_with_the_expected_shape_or_time(image, timestamp_s, message):
    with pytest.raises(SlamInitError, match=message):
        frame_of(image, timestamp_s, 0, CAMERA)


@pytest.mark.parametrize("index", [-5, 1.5, None, True, "3"])
def test_a_frame_has_an_index_from_zero_on(index):
    with pytest.raises(SlamInitError, match="give an integer from 0 on"):
        Frame(index, 0.0, "x", np.zeros((48, 64), np.uint8))


@pytest.mark.parametrize("size", [(20000, 2), (15, 480), (0, 10)])
def test_an_image_of_a_few_rows_is_no_image_of_a_camera(size):
    with pytest.raises(SlamInitError, match="at least 16 pixels"):
        Initializer(None).process(np.zeros(size[::-1], np.uint8) if min(size) else np.zeros((2, 10), np.uint8))
