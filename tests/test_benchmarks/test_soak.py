import numpy as np

from slam_init.types.camera import Camera
from tests.benchmarks.soak import soak

CAMERA = Camera("pinhole", 160, 120, 150.0, 150.0, 79.5, 59.5)


def test_each_tenth_has_its_frames_and_a_static_camera_never_ends_it():
    images = [np.random.default_rng(0).integers(0, 255, (120, 160), dtype=np.uint8)] * 3
    tenths = list(soak(images, CAMERA, frames=20))
    assert [tenth.frames for tenth in tenths] == list(range(2, 21, 2))
    assert all(tenth.memory_mb > 1 for tenth in tenths)
