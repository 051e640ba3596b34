"""A folder with good and bad files, and a stand-in for the pipeline."""

import cv2
import numpy as np
import pytest
from cli_files import CAMERA, IMAGES, INITIALIZED, NO_MAP

import slam_init.runner


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def pipeline(monkeypatch):
    """Stands in for the pipeline: records its arguments, gives what it is asked for."""

    class Fake:
        def __init__(self):
            self.summary, self.raises, self.calls = INITIALIZED, None, []

        def run(self, source, camera, config, **options):
            self.calls.append((source, camera, config, options))
            if self.raises:
                raise self.raises
            return NO_MAP, self.summary

    fake = Fake()
    monkeypatch.setattr(slam_init.runner, "run", fake.run, raising=False)
    return fake


@pytest.fixture
def images(tmp_path):
    folder = tmp_path / IMAGES
    folder.mkdir()
    for i in range(3):
        image = np.random.default_rng(i).integers(0, 255, (48, 64), dtype=np.uint8)
        (folder / f"{i}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return folder


@pytest.fixture
def world(tmp_path, images):
    """Files that can be wrong in every way, under short names."""
    files = {
        "good.yaml": CAMERA,
        "other_size.yaml": CAMERA.replace("64", "128"),
        "zero.yaml": CAMERA.replace("fx: 60", "fx: 0"),
        "file": "a file",
        "garbage.mp4": b"\0\1\2garbage" * 500,
        "cut/0.png": (images / "0.png").read_bytes()[:60],
        "full/something": "x",
        "result/summary.json": "{}",
        "result/config.toml": "",
    }
    for name, content in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    for i, size in enumerate([(64, 48), (32, 24)]):
        (tmp_path / "sizes").mkdir(exist_ok=True)
        data = cv2.imencode(".png", np.zeros(size[::-1], np.uint8))[1].tobytes()
        (tmp_path / "sizes" / f"{i}.png").write_bytes(data)
    return tmp_path
