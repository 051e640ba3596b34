"""A file that somebody has damaged is read, or refused in one line: one property for all readers."""

import tempfile
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from calibration_texts import FORMATS, SIZE
from hypothesis import given, settings
from hypothesis import strategies as st
from make_bag import small_bag
from make_files import picture, write
from make_layouts import LAYOUTS
from make_map import make_map
from make_matches import scene, write_database, write_hloc, write_tracks
from make_video import corner_frames, write_mp4

from slam_init.calibration.files import load_camera
from slam_init.datasets import open_source
from slam_init.datasets.image_files import read_image
from slam_init.datasets.map_files import open_map
from slam_init.datasets.track_source import TrackProvider
from slam_init.errors import SlamInitError
from slam_init.output.handover import handover_bytes
from slam_init.types.camera import Camera

pytestmark = pytest.mark.slow

CAMERA = Camera("pinhole", 64, 48, 60.0, 60.0, 31.5, 23.5)


def read_source(path):
    """What a source says of itself is consistent, and its first frames are images or tracks."""
    source = open_source(path)
    times_s = source.timestamps_s
    assert np.isfinite(times_s).all() and (np.diff(times_s) > 0).all() and len(times_s) <= len(source)
    for pose in () if source.groundtruth is None else source.groundtruth.world_from_cam:
        assert np.abs(pose.R @ pose.R.T - np.eye(3)).max() < 1e-9
    for frame in source.frames(max_frames=4):
        if isinstance(source, TrackProvider):
            assert np.isfinite(source.observed(frame, source.camera or CAMERA).pixels).all()
        else:
            assert frame.image.dtype == np.uint8


def encoded(suffix, folder):
    write(folder / f"a{suffix}", cv2.imencode(suffix, picture())[1].tobytes())


def bag(kind, folder):
    path = folder / ("bag.bag" if kind == "ros1" else "bag")
    small_bag(kind, [picture(i, channels=1) for i in range(3)], CAMERA).write(path)
    return path


#: By reader: writes sound files into a folder and returns what is opened, and reads it.
READERS = {
    **{f"image {suffix}": (partial(encoded, suffix), read_image) for suffix in (".png", ".jpg", ".tif", ".webp")},
    **{
        f"calibration {name}": (
            partial(lambda name, folder: write(folder / name, FORMATS[name][0]), name),
            partial(load_camera, image_size=SIZE),
        )
        for name in ("own.yaml", "opencv.yaml", "opencv.xml", "orb3.yaml", "kalibr.yaml", "sensor.yaml", "cameras.txt")
    },
    **{f"layout {name}": (layout.make, read_source) for name, layout in LAYOUTS.items()},
    **{f"bag {kind}": (partial(bag, kind), read_source) for kind in ("ros1", "sqlite3", "mcap")},
    "video": (lambda folder: write_mp4(folder / "a.mp4", corner_frames()), read_source),
    "database": (lambda folder: write_database(folder / "a.db", scene(points=20)), read_source),
    "hloc": (lambda folder: write_hloc(folder, scene(points=20)), read_source),
    "tracks": (lambda folder: write_tracks(folder / "a.npz", scene(points=20)), read_source),
    "handover": (lambda folder: write(folder / "handover.npz", handover_bytes(make_map())), open_map),
}
WORDS = ["nan", "1e999", "-1", "9" * 30, "", "\x00", "\u202e", "null", "!!python/object:os.system", "*a", "../../x"]


@st.composite
def damages(draw):
    """A change of a file: bytes are replaced, removed, repeated or cut off, or a word of a text is another one."""
    at, length = draw(st.floats(0, 1)), draw(st.sampled_from([1, 2, 4, 8, 64]))
    new = draw(st.binary(max_size=8) | st.sampled_from(WORDS).map(lambda word: word.encode("utf-8", "surrogatepass")))
    kind = draw(st.sampled_from(["replace", "remove", "repeat", "cut", "word"]))

    def change(data):
        k = int(at * len(data))
        if kind == "word":
            words = data.split(b" ")
            words[int(at * (len(words) - 1))] = new
            return b" ".join(words)
        middle = {"replace": new, "remove": b"", "repeat": 50 * data[k : k + length], "cut": b""}[kind]
        return data[:k] + middle + (b"" if kind == "cut" else data[k + length :])

    return change


@pytest.mark.parametrize("reader", READERS)
def test_a_damaged_file_is_read_or_refused_in_one_line(reader):
    make, read = READERS[reader]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        opened = make(folder) or next(folder.iterdir())
        read(opened)
        files = {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}

        @settings(max_examples=80)
        @given(st.sampled_from(sorted(files)), damages())
        def law(path, damage):
            path.write_bytes(damage(files[path]))
            try:
                read(opened)
            except SlamInitError:
                pass
            finally:
                path.write_bytes(files[path])

        law()
