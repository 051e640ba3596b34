"""The images of the last frames: the newest ones within the bound, never none."""

import numpy as np

from slam_init.frontend.orb import FrameMemory
from slam_init.types.frame import Frame


def frames(count, side=10):
    return (Frame(i, i / 30, "", np.full((side, side), i, np.uint8)) for i in range(count))


def test_the_newest_images_stay_within_the_bound_and_there_is_always_one():
    memory = FrameMemory(350)
    assert [frame.index for frame in memory.reading(frames(8))] == list(range(8))
    assert list(memory) == [5, 6, 7]
    assert memory[6][0, 0] == 6
    assert 4 not in memory
    # The newest image stays though it is larger than the bound.
    small = FrameMemory(10)
    list(small.reading(frames(3)))
    assert list(small) == [2]
    assert len(small) == 1
