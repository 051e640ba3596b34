"""Readers of camera calibrations in the common formats."""

from slam_init.calibration.files import load_camera

__all__ = ["load_camera"]
