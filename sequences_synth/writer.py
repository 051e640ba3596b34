"""Write a sequence as a folder in the layout of TUM RGB-D, or in that of EuRoC with its inertial sensor."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from sequences_synth.arrays import Floats
from sequences_synth.camera import PinholeCamera
from sequences_synth.inertial import InertialSamples
from sequences_synth.sequence import SynthSequence

#: Grey levels per metre of a 16-bit depth image of TUM RGB-D. The largest depth is then 13 m.
DEPTH_FACTOR = 5000.0
_MAX_DEPTH_LEVEL = 65535


def write_tum(
    sequence: SynthSequence, folder: str | os.PathLike[str], progress: Callable[[int], None] | None = None
) -> None:
    """Write a sequence in the layout of TUM RGB-D.

    The folder holds:

    * ``rgb.txt`` and ``depth.txt``: time stamp, file;
    * ``groundtruth.txt``: time stamp, tx ty tz, qx qy qz qw (world_from_cam, metres);
    * ``camera.yaml``: the stated camera;
    * ``images/000000.png`` and so on: BGR;
    * ``depth/000000.png`` and so on: z-depth in metres times a factor, 16 bit; 0 where there is no surface.

    The factor is 5000, as in TUM RGB-D. Where 16 bits do not reach the deepest point, it is divided by 10 until they
    do. A comment in ``camera.yaml`` states the factor.

    All files are written to a temporary folder beside the target, which is renamed at the end. If writing fails, the
    target does not exist.

    Parameters
    ----------
    sequence : SynthSequence
    folder : str or path-like
        Must not exist, or be an empty folder.
    progress : callable, optional
        Called after each frame with the number of frames written so far.

    Raises
    ------
    FileExistsError
        If ``folder`` is a file, or a folder that is not empty.
    OSError
        If an image cannot be written.
    """
    _write_whole(sequence, folder, progress, _write)


def write_euroc(
    sequence: SynthSequence, folder: str | os.PathLike[str], progress: Callable[[int], None] | None = None
) -> None:
    """Write a sequence that has an inertial sensor in the layout of EuRoC. The body is the sensor.

    The folder ``mav0`` holds:

    * ``cam0/data.csv`` and ``imu0/data.csv``: time stamps in nanoseconds, with files or rates and accelerations;
    * ``cam0/data/*.png``: BGR;
    * ``cam0/sensor.yaml`` and ``imu0/sensor.yaml``: ``T_BS``, the stated camera, and the noise densities;
    * ``state_groundtruth_estimate0/data.csv``: positions and quaternions w x y z of the body.

    Parameters
    ----------
    sequence : SynthSequence
        Made with the option ``imu``.
    folder, progress
        As for :func:`write_tum`.

    Raises
    ------
    ValueError
        If the sequence has no inertial sensor.
    FileExistsError, OSError
        As for :func:`write_tum`.
    """
    measured = sequence.inertial()
    if measured is None:
        raise ValueError("the sequence has no inertial sensor: make it with the option imu")
    _write_whole(sequence, folder, progress, partial(_write_euroc, measured))


def _write_whole(
    sequence: SynthSequence,
    folder: str | os.PathLike[str],
    progress: Callable[[int], None] | None,
    write: Callable[[SynthSequence, Path, Callable[[int], None] | None], None],
) -> None:
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileExistsError(f"{folder} exists already: name a new or an empty folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    # The temporary folder is beside the target, so that both are on one file system and the rename works.
    unfinished = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        write(sequence, unfinished, progress)
        unfinished.chmod(0o755)  # mkdtemp makes private folders
        unfinished.replace(folder)
    except BaseException:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise


def _write(sequence: SynthSequence, folder: Path, progress: Callable[[int], None] | None) -> None:
    for name in ("images", "depth"):
        (folder / name).mkdir()
    factor = _depth_factor(sequence)
    for index, _, image, depth, _ in sequence.frames():
        _write_png(folder / "images" / f"{index:06d}.png", image)
        levels = np.round(depth * factor)
        levels[levels > _MAX_DEPTH_LEVEL] = 0  # out of the range of the format: no measurement
        _write_png(folder / "depth" / f"{index:06d}.png", levels.astype(np.uint16))
        if progress is not None:
            progress(index + 1)

    times = sequence.timestamps_s
    (folder / "camera.yaml").write_text(_camera_text(sequence, factor))
    poses = "".join(_pose_line(time, pose) for time, pose in zip(times, sequence.poses, strict=True))
    header = "# camera-to-world (T_wc), quaternion order x y z w, optical frame: x right, y down, z forward\n"
    (folder / "groundtruth.txt").write_text(header + "# timestamp tx ty tz qx qy qz qw\n" + poses)
    for name, sub in (("depth.txt", "depth"), ("rgb.txt", "images")):
        lines = "".join(f"{time:.6f} {sub}/{index:06d}.png\n" for index, time in enumerate(times))
        (folder / name).write_text("# timestamp filename\n" + lines)


def _write_euroc(
    measured: InertialSamples, sequence: SynthSequence, folder: Path, progress: Callable[[int], None] | None
) -> None:
    cam0, imu0, truth = (folder / "mav0" / name for name in ("cam0", "imu0", "state_groundtruth_estimate0"))
    for made in (cam0 / "data", imu0, truth):
        made.mkdir(parents=True)
    # The sensor is on before the first frame, and stamps are not negative.
    stamps = [_nanoseconds(time_s) for time_s in sequence.timestamps_s.tolist()]
    for index, _, image, _, _ in sequence.frames():
        _write_png(cam0 / "data" / f"{stamps[index]}.png", image)
        if progress is not None:
            progress(index + 1)
    (cam0 / "data.csv").write_text("#timestamp [ns],filename\n" + "".join(f"{stamp},{stamp}.png\n" for stamp in stamps))
    body_from_cam = np.asarray(np.linalg.inv(measured.cam_from_imu), float)
    (cam0 / "sensor.yaml").write_text(_transform_text(body_from_cam) + _camera_text(sequence, None))
    noise = measured.noise
    (imu0 / "sensor.yaml").write_text(
        _transform_text(np.eye(4)) + f"gyroscope_noise_density: {noise.gyroscope_density!r}\n"
        f"accelerometer_noise_density: {noise.accelerometer_density!r}\n"
    )
    samples = np.concatenate([measured.rates_rad_s, measured.accelerations_m_s2], axis=1)
    rows = zip(measured.timestamps_s.tolist(), samples.tolist(), strict=True)
    (imu0 / "data.csv").write_text(
        "#timestamp [ns],w_x,w_y,w_z [rad/s],a_x,a_y,a_z [m/s^2]\n"
        + "".join(f"{_nanoseconds(time_s)},{','.join(f'{value:.9f}' for value in row)}\n" for time_s, row in rows)
    )
    lines = []
    for stamp, pose in zip(stamps, sequence.poses @ measured.cam_from_imu, strict=True):
        x, y, z, w = _quaternion_xyzw(pose[:3, :3])
        lines.append(f"{stamp},{','.join(f'{value:.9f}' for value in (*pose[:3, 3], w, x, y, z))}\n")
    (truth / "data.csv").write_text("#timestamp [ns],p_x,p_y,p_z [m],q_w,q_x,q_y,q_z\n" + "".join(lines))


#: Time stamps of EuRoC's layout begin here: a second after the start of a device.
_START_S = 1.0


def _nanoseconds(time_s: float) -> int:
    return round((time_s + _START_S) * 1e9)


def _transform_text(body_from_sensor: Floats) -> str:
    return f"T_BS:\n  data: {body_from_sensor.ravel().tolist()!r}\n"


def _write_png(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    import cv2

    # Compression level 1: noise cannot be compressed, and the default level takes three times as long.
    # OpenCV's own writer does not tell a full disk from another failure.
    encoded, png = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not encoded:
        raise OSError(f"cannot encode {path}")
    path.write_bytes(png.tobytes())


def _depth_factor(sequence: SynthSequence) -> float:
    """TUM's factor, divided by 10 until the deepest point of the first and last frame fits into 16 bits."""
    deepest = max(float(sequence.render(index)[1].max()) for index in {0, len(sequence) - 1})
    factor = DEPTH_FACTOR
    while 1.5 * deepest * factor > _MAX_DEPTH_LEVEL:
        factor /= 10
    return factor


def _camera_text(sequence: SynthSequence, depth_factor: float | None) -> str:
    camera = sequence.camera
    model, coefficients = ("pinhole", ()) if isinstance(camera, PinholeCamera) else (camera.model, camera.coefficients)
    return (
        f"model: {model}\n"
        f"width: {camera.width}\nheight: {camera.height}\n"
        f"fx: {camera.fx!r}\nfy: {camera.fy!r}\ncx: {camera.cx!r}\ncy: {camera.cy!r}\n"
        f"distortion_model: {'none' if model == 'pinhole' else model}\ndistortion: {list(coefficients)!r}\n"
    ) + (
        ""
        if depth_factor is None
        else f"# depth images: metres times {depth_factor:g}, 16 bit, 0 where there is none\n"
    )


def _pose_line(timestamp_s: float, world_from_cam: Floats) -> str:
    x, y, z = world_from_cam[:3, 3]
    qx, qy, qz, qw = _quaternion_xyzw(world_from_cam[:3, :3])
    return f"{timestamp_s:.6f} {x:.9f} {y:.9f} {z:.9f} {qx:.9f} {qy:.9f} {qz:.9f} {qw:.9f}\n"


def _quaternion_xyzw(R: Floats) -> Floats:
    """Unit quaternion x y z w, w >= 0: the leading eigenvector of the matrix of Bar-Itzhack (2000)."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    symmetric = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    q = np.linalg.eigh(symmetric)[1][:, -1]
    return cast(Floats, q if q[3] >= 0 else -q)
