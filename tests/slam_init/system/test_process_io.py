"""An interrupt ends a command, wherever it comes."""

import ctypes
import signal
import time

import pytest

from slam_init.system.process_io import interrupts_noted


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_in_a_callback_of_a_c_library_comes_again_and_each_time_it_is_dropped(number):
    """Python drops what a callback raises: the compiler has such callbacks, and may be in one for seconds."""
    callback = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(number))
    seen: list[int] = []
    before = signal.signal(number, signal.SIG_DFL)  # a shell starts what runs in the background without SIGINT
    with pytest.raises(KeyboardInterrupt), interrupts_noted(seen):
        callback()
        busy = ctypes.CFUNCTYPE(None)(lambda: time.sleep(0.3))
        busy()
        time.sleep(60)
    signal.signal(number, before)
    assert seen[0] == number
