"""The readers that get mutated files, and the sound files that the mutations start from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam_init.datasets import TimedSource
from slam_init.types.frame import notes_of

_SIZE = (64, 48)
_CAMERA = "model: pinhole\nwidth: 64\nheight: 48\nfx: 60\nfy: 60\ncx: 31.5\ncy: 23.5\n"
_SENSOR = (
    "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1]\n"
    "rate_hz: 20\nresolution: [64, 48]\ncamera_model: pinhole\nintrinsics: [60, 61, 31, 23]\n"
    "distortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]\n"
)
_CALIBRATIONS = {
    "own.yaml": _CAMERA + "distortion_model: radtan\ndistortion: [0.1, -0.05, 0.001, 0.002, 0.01]\nreadout_ms: 25\n",
    "opencv.yaml": "%YAML:1.0\n---\nimage_width: 64\nimage_height: 48\ncamera_matrix: !!opencv-matrix\n   rows: 3\n"
    "   cols: 3\n   dt: d\n   data: [60., 0., 31., 0., 61., 23., 0., 0., 1.]\ndistortion_coefficients: "
    "!!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [0.1, -0.05, 0.001, 0.002, 0.01]\n",
    "orb.yaml": "%YAML:1.0\nCamera.type: KannalaBrandt8\nCamera.fx: 60\nCamera.fy: 60\nCamera.cx: 31\nCamera.cy: 23\n"
    "Camera.k1: 0.003\nCamera.k2: 0.0007\nCamera.k3: -0.002\nCamera.k4: 0.0002\nCamera.width: 64\nCamera.height: 48\n",
    "kalibr.yaml": "cam0:\n  camera_model: pinhole\n  intrinsics: [60, 61, 31, 23]\n  distortion_model: equidistant\n"
    "  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]\n  resolution: [64, 48]\n  line_delay: 3.0e-05\n",
    "sensor.yaml": _SENSOR,
    "opencv.xml": "<?xml version='1.0'?>\n<opencv_storage>\n<image_width>64</image_width>\n<image_height>48"
    "</image_height>\n<camera_matrix type_id='opencv-matrix'><rows>3</rows><cols>3</cols><dt>d</dt>\n"
    "<data>60. 0. 31. 0. 61. 23. 0. 0. 1.</data></camera_matrix>\n<distortion_coefficients type_id='opencv-matrix'>"
    "<rows>1</rows><cols>4</cols><dt>d</dt><data>0.1 -0.05 0.001 0.002</data></distortion_coefficients>\n"
    "</opencv_storage>\n",
}
_COLMAP = {
    f"{model}.txt": f"# Camera list with one line of data per camera:\n1 {model} 64 48 {parameters}\n"
    for model, parameters in {
        "PINHOLE": "60 61 32 24",
        "SIMPLE_RADIAL": "60 32 24 0.1",
        "OPENCV": "60 61 32 24 0.1 -0.05 0.001 0.002",
        "OPENCV_FISHEYE": "60 61 32 24 0.003 0.0007 -0.002 0.0002",
        "FULL_OPENCV": "60 61 32 24 0.1 -0.05 0.001 0.002 0.01 0 0 0",
    }.items()
}


@dataclass(frozen=True)
class Target:
    """A reader under test."""

    #: Whether its files are texts.
    is_text: bool
    #: Makes the sound files: name, relative to the folder, and content. One of them is mutated at a time.
    seeds: Callable[[], Mapping[str, bytes]]
    #: Makes the files that stay sound.
    around: Callable[[], Mapping[str, bytes]]
    #: Reads the mutated file, given the folder and the name of the file. Raises what the reader raises, and
    #: AssertionError if it returns what cannot be.
    read: Callable[[Path, str], None]


def _picture(seed: int, channels: int = 3, dtype: type = np.uint8) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shape = (_SIZE[1], _SIZE[0], channels) if channels > 1 else (_SIZE[1], _SIZE[0])
    return np.asarray(rng.integers(0, np.iinfo(dtype).max, shape, dtype=dtype))


def _encoded(suffix: str, image: np.ndarray) -> bytes:
    import cv2

    return bytes(cv2.imencode(suffix, image)[1].tobytes())


def _images() -> dict[str, bytes]:
    files = {
        f"colour{suffix}": _encoded(suffix, _picture(0))
        for suffix in (".png", ".jpg", ".bmp", ".ppm", ".tif", ".webp", ".jp2")
    }
    files["grey.pgm"] = _encoded(".pgm", _picture(0, 1))
    files["alpha.png"] = _encoded(".png", _picture(0, 4))
    for suffix in (".png", ".tif", ".jp2"):
        files[f"deep{suffix}"] = _encoded(suffix, _picture(0, 3, np.uint16))
    return files


def _videos() -> dict[str, bytes]:
    import tempfile

    import cv2

    files = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, codec in (
            ("a.avi", "MJPG"),
            ("a.mp4", "mp4v"),
            ("b.avi", "XVID"),
            ("a.mkv", "MJPG"),
            ("a.webm", "VP80"),
            ("a.mov", "MJPG"),
            ("a.ts", "mp2v"),
        ):
            path = Path(folder, name)
            writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), 20.0, _SIZE)
            for i in range(6):
                writer.write(_picture(i))
            writer.release()
            if path.is_file() and path.stat().st_size:
                files[name] = path.read_bytes()
    return files


def _made(write: Callable[[Path], object]) -> dict[str, bytes]:
    """The files that a maker writes to a folder."""
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(folder)
        paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _database() -> dict[str, bytes]:
    from tests.support.make_matches import scene, write_database

    return _made(lambda folder: write_database(folder / "database.db", scene(points=20)))


def _hloc() -> dict[str, bytes]:
    from tests.support.make_matches import scene, write_hloc

    return _made(lambda folder: write_hloc(folder, scene(points=20)))


def _tracks() -> dict[str, bytes]:
    from tests.support.make_matches import scene, write_tracks

    return _made(lambda folder: write_tracks(folder / "tracks.npz", scene(points=20)))


def _bag(kind: str) -> Callable[[], Mapping[str, bytes]]:
    from slam_init.types.camera import Camera

    def make() -> Mapping[str, bytes]:
        from tests.support.make_bag import small_bag

        images = [_picture(i, 1) for i in range(3)]
        messages = small_bag(kind, images, Camera("pinhole", *_SIZE, 60.0, 60.0, 31.5, 23.5))
        return _made(lambda folder: messages.write(folder / ("bag.bag" if kind == "ros1" else "bag")))

    return make


def _graph() -> dict[str, bytes]:
    import gtsam

    graph, values, K = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.Cal3_S2(60.0, 60.0, 0.0, 31.5, 23.5)
    noise = gtsam.noiseModel.Isotropic.Sigma(2, 1.0)
    for i in range(2):
        values.insert(gtsam.symbol("x", i), gtsam.Pose3(gtsam.Rot3(), np.array([0.1 * i, 0.0, 0.0])))
        for j in range(3):
            pixel = np.array([20.0 + j, 20.0])
            graph.add(gtsam.GenericProjectionFactorCal3_S2(pixel, noise, gtsam.symbol("x", i), gtsam.symbol("l", j), K))
    for j in range(3):
        values.insert(gtsam.symbol("l", j), np.array([0.1 * j, 0.0, 1.0]))
    return {"graph.txt": graph.serialize().encode(), "values.txt": values.serialize().encode()}


def _tum() -> dict[str, bytes]:
    rows = [f"{1305031453.359684 + i / 30:.6f}" for i in range(4)]
    poses = "".join(f"{t} {i} 0.5 -1 0 0.6 0 0.8\n" for i, t in enumerate(rows))
    return {
        "rgb.txt": ("# timestamp filename\n" + "".join(f"{t} {i}.png\n" for i, t in enumerate(rows))).encode(),
        "groundtruth.txt": f"# timestamp tx ty tz qx qy qz qw\n{poses}".encode(),
        "camera.yaml": _CAMERA.encode(),
    }


def _kitti() -> dict[str, bytes]:
    row = "60 0 31 {} 0 60 23 0 0 0 1 0"
    return {
        "s/00/times.txt": b"0.000000e+00\n1.036224e-01\n2.073409e-01\n3.110000e-01\n",
        "s/00/calib.txt": f"P0: {row.format(0)}\nP1: {row.format(-30)}\nTr: 1 0 0\n".encode(),
        "poses/00.txt": b"1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 0 0 1 0 0 -1 0 0 2\n" + 2 * b"1 0 0 1 0 1 0 2 0 0 1 3\n",
    }


def _euroc() -> dict[str, bytes]:
    rows = [1403636579763555584 + 50_000_000 * i for i in range(4)]
    return {
        "mav0/cam0/data.csv": (
            "#timestamp [ns],filename\r\n" + "".join(f"{t},{i}.png\r\n" for i, t in enumerate(rows))
        ).encode(),
        "mav0/cam0/sensor.yaml": _SENSOR.encode(),
        "mav0/state_groundtruth_estimate0/data.csv": (
            "#timestamp, p_RS_R_x [m]\n" + "".join(f"{t},5,6,7,0.8,0.6,0,0,0,0,0\n" for t in rows)
        ).encode(),
    }


def _four_images(folder: str) -> Callable[[], Mapping[str, bytes]]:
    return lambda: {f"{folder}{i}.png": _encoded(".png", _picture(i)) for i in range(4)}


def _encoded_texts(texts: Mapping[str, str]) -> Callable[[], Mapping[str, bytes]]:
    return lambda: {name: text.encode() for name, text in texts.items()}


def _read_image(folder: Path, name: str) -> None:
    from slam_init.datasets.image_files import MAX_PIXELS, read_image

    image = read_image(folder / name, folder)
    assert image.dtype == np.uint8 and image.ndim in (2, 3) and 0 < image.size <= 3 * MAX_PIXELS


def _read_calibration(folder: Path, name: str) -> None:
    from slam_init.calibration.files import load_camera

    camera = load_camera(folder / name, _SIZE)
    assert (camera.width, camera.height) == _SIZE and np.isfinite([camera.fx, camera.fy, camera.cx, camera.cy]).all()


def _read_source(path: Path) -> None:
    from slam_init.datasets import open_source
    from slam_init.datasets.describe import describe

    source = open_source(path)
    describe(source, source.camera)
    _check(source, source.timestamps_s)
    for frame in source.frames(max_frames=8):
        assert frame.image.dtype == np.uint8


def _read_tracks(path: Path) -> None:
    from slam_init.datasets import open_source
    from slam_init.datasets.track_source import KnowsTracks
    from slam_init.types.camera import Camera

    source = open_source(path)
    _check(source, source.timestamps_s)
    assert isinstance(source, KnowsTracks)
    camera = source.camera or Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)
    for frame in source.frames(max_frames=8):
        observed = source.observed(frame, camera)
        assert np.isfinite(observed.pixels).all() and (np.diff(observed.track_ids) > 0).all()


def _read_graph(folder: Path) -> None:
    from slam_init.output.results import load_graph

    graph, values = load_graph(folder)
    graph.keys()
    values.keys()


def _check(source: TimedSource, times_s: np.ndarray) -> None:
    assert np.isfinite(times_s).all() and (np.diff(times_s) > 0).all()
    # A bag states how many messages its index names. Where fewer can be used, a note tells which are missing.
    told = source.kind in ("ros1", "ros2") and any("left out" in n or "damaged" in n for n in notes_of(source))
    assert len(times_s) == len(source) or (told and 0 < len(times_s) < len(source))
    poses = () if source.groundtruth is None else source.groundtruth.world_from_cam
    for pose in poses:
        assert np.abs(pose.R @ pose.R.T - np.eye(3)).max() < 1e-9, "a matrix that is no rotation"
        assert abs(np.linalg.det(pose.R) - 1) < 1e-9, "a matrix that is no rotation"


def _none() -> Mapping[str, bytes]:
    return {}


TARGETS = {
    "images": Target(False, _images, _none, _read_image),
    "videos": Target(False, _videos, _none, lambda folder, name: _read_source(folder / name)),
    "YAML and XML": Target(True, _encoded_texts(_CALIBRATIONS), _none, _read_calibration),
    "COLMAP": Target(True, _encoded_texts(_COLMAP), _none, _read_calibration),
    "COLMAP databases": Target(False, _database, _none, lambda folder, _: _read_tracks(folder / "database.db")),
    "hloc": Target(False, _hloc, _none, lambda folder, _: _read_tracks(folder / "feats_matches_pairs.h5")),
    "tracks.npz": Target(False, _tracks, _none, lambda folder, _: _read_tracks(folder / "tracks.npz")),
    "bags of ROS 1": Target(False, _bag("ros1"), _none, lambda folder, _: _read_source(folder / "bag.bag")),
    "bags of ROS 2, SQLite": Target(False, _bag("sqlite3"), _none, lambda folder, _: _read_source(folder / "bag")),
    "bags of ROS 2, MCAP": Target(False, _bag("mcap"), _none, lambda folder, _: _read_source(folder / "bag")),
    "graphs": Target(False, _graph, _none, lambda folder, _: _read_graph(folder)),
    "TUM": Target(True, _tum, _four_images(""), lambda folder, _: _read_source(folder)),
    "KITTI": Target(True, _kitti, _four_images("s/00/image_0/"), lambda folder, _: _read_source(folder / "s" / "00")),
    "EuRoC": Target(True, _euroc, _four_images("mav0/cam0/data/"), lambda folder, _: _read_source(folder)),
}
