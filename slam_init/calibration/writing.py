"""Writes a calibration in the YAML of this project, which :func:`slam_init.calibration.files.load_camera` reads."""

from __future__ import annotations

from slam_init.types.camera import Camera


def camera_yaml(camera: Camera) -> str:
    """Write a calibration."""
    lines = [
        "# pixel centres at integer coordinates; distortion as in OpenCV",
        "model: pinhole" if camera.model != "fisheye" else "model: fisheye",
        f"width: {camera.width}",
        f"height: {camera.height}",
        *(f"{name}: {float(getattr(camera, name))!r}" for name in ("fx", "fy", "cx", "cy")),
        f"distortion_model: {'none' if camera.model == 'pinhole' else camera.model}",
        f"distortion: [{', '.join(repr(float(value)) for value in camera.distortion)}]",
    ]
    if camera.focal_sigma is not None:
        lines.append(f"focal_sigma: {float(camera.focal_sigma)!r}  # relative standard deviation of fx and fy")
    if camera.readout_ms is not None:
        lines += [f"readout_ms: {float(camera.readout_ms)!r}", f"readout_direction: {camera.readout_direction}"]
    return "\n".join(lines) + "\n"
