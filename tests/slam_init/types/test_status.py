"""Laws of the status and of the frames that are made from images."""

import numpy as np
import pytest
from make_map import make_window_evidence

from slam_init.errors import SlamInitError
from slam_init.initializer import Initializer
from slam_init.types.refusal import Verdict
from slam_init.types.result import Attempt
from slam_init.types.status import Status


def test_the_window_and_its_risk_stay_until_another_window_is_evaluated():
    windows = [make_window_evidence(risk) for risk in (0.4, 0.001)]
    attempts = [Attempt((0, k), Verdict.LOW_PARALLAX, window=window) for k, window in enumerate(windows, 1)]
    assert Status().risk is None
    status = Status().after(attempts[0], 0.4)
    assert status.risk == 0.4
    assert status.after(None, 0.3).after(Attempt((0, 2), Verdict.TOO_FEW_MATCHES), 0.2).window == windows[0]
    assert Status.initialized(attempts[1]).risk == 0.001


@pytest.mark.parametrize("size", [(20000, 2), (15, 480), (0, 10)])
def test_an_image_of_a_few_rows_is_no_image_of_a_camera(size):
    with pytest.raises(SlamInitError, match="at least 16 pixels"):
        Initializer(None).process(np.zeros(size[::-1], np.uint8) if min(size) else np.zeros((2, 10), np.uint8))
