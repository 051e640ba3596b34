"""A small folder in the layout of TUM RGB-D, which several tests read."""

from __future__ import annotations

from pathlib import Path

import pytest
from make_files import CAMERA_YAML, picture, write, write_image


@pytest.fixture
def tum(tmp_path: Path) -> Path:
    """Three images at 10 Hz with calibration and ground truth."""
    folder = tmp_path / "a séquence with spaces"
    for i in range(3):
        write_image(folder / "images" / f"{i}.png", picture(i))
    write(folder / "rgb.txt", "# timestamp filename\n" + "".join(f"{i / 10} images/{i}.png\n" for i in range(3)))
    write(folder / "groundtruth.txt", "".join(f"{i / 10 + 0.005} {i} 0 0 0 0 0 1\n" for i in range(3)))
    write(folder / "camera.yaml", CAMERA_YAML)
    return folder
