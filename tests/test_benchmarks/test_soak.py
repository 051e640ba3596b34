import numpy as np

from slam_init.types.camera import Camera
from tests.benchmarks.soak import soak

CAMERA = Camera("pinhole", 160, 120, 150.0, 150.0, 79.5, 59.5)


def test_each_tenth_has_frames_and_a_static_camera_never_ends_it():
    images = [np.random.default_rng(0).integers(0, 255, (120, 160), dtype=np.uint8)] * 2
    tenths = list(soak(images, CAMERA, seconds=0.1, rate_hz=1000))
    assert len(tenths) == 10
    assert all(tenth.frames >= 1 and tenth.memory_mb > 1 for tenth in tenths)
