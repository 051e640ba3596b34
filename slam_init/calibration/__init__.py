"""Camera calibrations: readers of the formats that people have."""

from slam_init.calibration.files import load_camera

__all__ = ["load_camera"]
