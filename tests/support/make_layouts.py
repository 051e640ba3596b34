"""Small sequences in the layouts of data sets: each image has a bright spot, where a known point of the world is seen.

The conventions of a layout are given in words, the directions of its camera axes (``right``, ``down``, ``forward`` and
their opposites), and not as the matrices of the readers.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from make_files import write, write_image

SIZE = (64, 48)
FOCAL, CENTRE = 60.0, (30.5, 24.0)
#: In the world.
POINT = np.array([0.3, -0.2, 4.0])
FRAMES = 3

_DIRECTIONS = {"right": (1, 0, 0), "down": (0, 1, 0), "forward": (0, 0, 1)}
_OPPOSITE = {"left": "right", "up": "down", "backward": "forward"}


def axes(*words: str) -> np.ndarray:
    """Columns: camera axes of a layout in the axes right, down, forward."""
    columns = [np.array(_DIRECTIONS[w]) if w in _DIRECTIONS else -np.array(_DIRECTIONS[_OPPOSITE[w]]) for w in words]
    return np.array(columns, float).T


def pose(i: int) -> np.ndarray:
    """World_from_cam (4, 4) of frame i: no axis is special."""
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.05 * i - 0.02, 0.1 - 0.08 * i, 0.03 + 0.02 * i]))[0]
    T[:3, 3] = 0.2 * i, 0.1 - 0.1 * i, 0.05 * i
    return T


def pose_in(i: int, *words: str) -> np.ndarray:
    """World_from_cam (4, 4) of frame i, of a camera with these axes."""
    T = pose(i)
    T[:3, :3] = T[:3, :3] @ axes(*words)
    return T


def spot(i: int, focal: float = FOCAL, centre: tuple[float, float] = CENTRE) -> np.ndarray:
    """Pixel of the point in frame i, with the centre of the first pixel at 0."""
    x, y, z = pose(i)[:3, :3].T @ (POINT - pose(i)[:3, 3])
    return np.array([focal * x / z + centre[0], focal * y / z + centre[1]])


def write_spot(path: Path, i: int, focal: float = FOCAL, centre: tuple[float, float] = CENTRE) -> None:
    """Write the image of frame i: a smooth spot, whose weighted mean is its position."""
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    u, v = spot(i, focal, centre)
    write_image(path, np.round(250 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 8)).astype(np.uint8))


def found_spot(image: np.ndarray) -> np.ndarray:
    """Position of the spot of an image."""
    weights = image.astype(float)
    rows, columns = np.indices(image.shape)
    return np.array([(weights * columns).sum(), (weights * rows).sum()]) / weights.sum()


def quaternion(R: np.ndarray) -> tuple[float, float, float, float]:
    """(x, y, z, w) of a rotation."""
    vector = cv2.Rodrigues(R)[0].ravel()
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle * math.sin(angle / 2) if angle else np.zeros(3)
    return float(x), float(y), float(z), math.cos(angle / 2)


def text(values: object, separator: str = " ") -> str:
    return separator.join(repr(float(v)) for v in np.ravel(np.array(values, float)))


def tum_line(stamp: object, T: np.ndarray) -> str:
    return f"{stamp} {text([*T[:3, 3], *quaternion(T[:3, :3])])}\n"


@dataclass(frozen=True)
class Layout:
    """A maker of a folder, and what its reader must find."""

    kind: str
    #: Writes the files into a folder and returns the folder to open.
    make: Callable[[Path], Path]
    #: Files that a reader cannot do without, relative to the opened folder.
    tables: tuple[str, ...]
    #: The time stamps; None where the layout has none.
    stamps_s: tuple[float, ...] | None = None
    #: focal, centre: (float, float)
    focal: float = FOCAL
    centre: tuple[float, float] = field(default=CENTRE)


EUROC_STAMPS = tuple(1403636579763555584 + 50_000_000 * i for i in range(FRAMES))

K_ROWS = [[FOCAL, 0, CENTRE[0]], [0, FOCAL, CENTRE[1]], [0, 0, 1]]


def eth3d(folder: Path, stamps: Sequence[object] = ("10.000000", "10.100000", "10.200000")) -> Path:
    for i in range(len(stamps)):
        write_spot(folder / "rgb" / f"{i}.png", i)
    write(folder / "rgb.txt", "".join(f"{stamp} rgb/{i}.png\n" for i, stamp in enumerate(stamps)))
    write(folder / "groundtruth.txt", "".join(tum_line(stamp, pose(i)) for i, stamp in enumerate(stamps)))
    write(folder / "calibration.txt", f"{FOCAL} {FOCAL} {CENTRE[0]} {CENTRE[1]}\n")
    return folder


def euroc(folder: Path, stamps: Sequence[object] = EUROC_STAMPS) -> Path:
    mav = folder / "MH_01" / "mav0"
    body_from_cam = np.eye(4)
    body_from_cam[:3, :3], body_from_cam[:3, 3] = axes("left", "down", "backward"), (0.01, 0.02, 0.03)
    for i, stamp in enumerate(stamps):
        write_spot(mav / "cam0" / "data" / f"{stamp}.png", i)
    rows = "".join(f"{stamp},{stamp}.png\r\n" for stamp in stamps)
    write(mav / "cam0" / "data.csv", "#timestamp [ns],filename\r\n" + rows)
    write(
        mav / "cam0" / "sensor.yaml",
        f"T_BS:\n  rows: 4\n  cols: 4\n  data: [{text(body_from_cam, ', ')}]\nresolution: [64, 48]\n"
        f"intrinsics: [{FOCAL}, {FOCAL}, {CENTRE[0]}, {CENTRE[1]}]\ndistortion_model: radial-tangential\n"
        "distortion_coefficients: [0, 0, 0, 0]\n",
    )
    lines = []
    for i, stamp in enumerate(stamps):
        world_from_body = pose(i) @ np.linalg.inv(body_from_cam)
        x, y, z, w = quaternion(world_from_body[:3, :3])
        lines.append(f"{stamp},{text([*world_from_body[:3, 3], w, x, y, z], ',')},0,0\n")
    write(mav / "state_groundtruth_estimate0" / "data.csv", "#timestamp, p_RS_R_x [m], ...\n" + "".join(lines))
    return mav.parent


def kitti(folder: Path, stamps: Sequence[object] = ("0.000000e+00", "1.04e-01", "2.07e-01")) -> Path:
    sequence = folder / "dataset" / "sequences" / "06"
    K = np.array(K_ROWS)
    # Camera 2 stands 0.6 to the right of camera 0.
    P2 = np.column_stack([K, K @ [-0.6, 0.0, 0.0]])
    lines = []
    for i in range(len(stamps)):
        write_spot(sequence / "image_2" / f"{i:06d}.png", i)
        T = pose(i)
        T[:3, 3] -= 0.6 * T[:3, 0]
        lines.append(f"{text(T[:3])}\n")
    write(sequence / "times.txt", "".join(f"{stamp}\n" for stamp in stamps))
    write(sequence / "calib.txt", f"P0: {text(np.column_stack([K, np.zeros(3)]))}\nP2: {text(P2)}\nTr: 1\n")
    write(folder / "dataset" / "poses" / "06.txt", "".join(lines))
    return sequence / "image_2"


def tartanair(folder: Path) -> Path:
    for i in range(FRAMES):
        write_spot(folder / "image_left" / f"{i:06d}_left.png", i, 32.0, (32.0, 24.0))
    poses = [pose_in(i, "forward", "right", "down") for i in range(FRAMES)]
    write(folder / "pose_left.txt", "".join(tum_line("", T).lstrip() for T in poses))
    return folder


def transforms(folder: Path) -> Path:
    # Pixel centres at .5. The names are in no order, and one image is not in the folder.
    order = [10, 2, 1]
    for i, number in enumerate(sorted(order)):
        write_spot(folder / "images" / f"frame_{number}.png", i)
    frames = [
        {
            "file_path": f"./images/frame_{number}.png",
            "transform_matrix": pose_in(i, "right", "up", "backward").tolist(),
        }
        for i, number in ((2, 10), (1, 2), (0, 1), (0, 11))
    ]
    lens = {"fl_x": FOCAL, "fl_y": FOCAL, "cx": CENTRE[0] + 0.5, "cy": CENTRE[1] + 0.5, "w": 64, "h": 48}
    write(folder / "transforms.json", json.dumps({**lens, "camera_model": "OPENCV", "frames": frames}))
    return folder


def _colmap_pose(i: int) -> list[float]:
    cam_from_world = np.linalg.inv(pose(i))
    x, y, z, w = quaternion(cam_from_world[:3, :3])
    return [w, x, y, z, *cam_from_world[:3, 3].tolist()]


def colmap_text(folder: Path) -> Path:
    lines = ["# IMAGE_ID, QW, ...\n"]
    for i in range(FRAMES):
        write_spot(folder / "images" / f"view {i}.png", i)
        points = "" if i == 1 else "1.5 2.5 -1 3.5 4.5 7"  # a line without points is empty
        lines.append(f"{9 - i} {text(_colmap_pose(i))} 3 view {i}.png\n{points}\n")
    lens = f"3 PINHOLE 64 48 {FOCAL} {FOCAL} {CENTRE[0] + 0.5} {CENTRE[1] + 0.5}\n"
    write(folder / "sparse" / "0" / "cameras.txt", lens)
    write(folder / "sparse" / "0" / "images.txt", "".join(lines))
    return folder


def colmap_binary(folder: Path) -> Path:
    cameras = struct.pack("<QiiQQ4d", 1, 3, 1, 64, 48, FOCAL, FOCAL, CENTRE[0] + 0.5, CENTRE[1] + 0.5)
    images = struct.pack("<Q", FRAMES)
    for i in range(FRAMES):
        write_spot(folder / "images" / "dslr" / f"{i}.png", i)
        points = struct.pack("<Qddq", 1, 1.5, 2.5, -1)
        images += struct.pack("<i7di", i, *_colmap_pose(i), 3) + f"dslr/{i}.png".encode() + b"\0" + points
    write(folder / "dslr_calibration_undistorted" / "cameras.bin", cameras)
    write(folder / "dslr_calibration_undistorted" / "images.bin", images)
    return folder


def trakmark(folder: Path) -> Path:
    lines = []
    for i in range(FRAMES):
        write_spot(folder / "images" / f"{i:04d}.png", i)
        lines.append(f"{i},{text(np.linalg.inv(pose(i))[:3], ',')}\n")
    write(folder / "Extrinsic.csv", "".join(lines))
    write(folder / "intrinsic.txt", "\n".join(text(row) for row in K_ROWS) + "\n")
    return folder


LAYOUTS = {
    "euroc": Layout("euroc", euroc, ("mav0/cam0/data.csv", "mav0/state_groundtruth_estimate0/data.csv")),
    "kitti": Layout("kitti", kitti, ("../times.txt", "../calib.txt"), (0.0, 0.104, 0.207)),
    "eth3d": Layout("tum", eth3d, ("calibration.txt", "groundtruth.txt"), (10.0, 10.1, 10.2)),
    "tartanair": Layout("tartanair", tartanair, ("pose_left.txt",), (0.0, 0.1, 0.2), 32.0, (32.0, 24.0)),
    "transforms": Layout("transforms", transforms, ("transforms.json",)),
    "colmap-text": Layout("colmap", colmap_text, ("sparse/0/cameras.txt", "sparse/0/images.txt")),
    "colmap-binary": Layout(
        "colmap", colmap_binary, ("dslr_calibration_undistorted/cameras.bin", "dslr_calibration_undistorted/images.bin")
    ),
    "trakmark": Layout("trakmark", trakmark, ("Extrinsic.csv", "intrinsic.txt")),
}
