"""Write a sequence as a folder in the layout of TUM RGB-D."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sequences_synth.arrays import Floats
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
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileExistsError(f"{folder} exists already: name a new or an empty folder")
    for name in ("images", "depth"):
        (folder / name).mkdir(parents=True)
    factor = _depth_factor(sequence)
    for index in range(len(sequence)):
        image, depth = sequence.render(index)
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


def _camera_text(sequence: SynthSequence, depth_factor: float) -> str:
    camera = sequence.camera
    return (
        f"model: {camera.model}\n"
        f"width: {camera.width}\nheight: {camera.height}\n"
        f"fx: {camera.fx!r}\nfy: {camera.fy!r}\ncx: {camera.cx!r}\ncy: {camera.cy!r}\n"
        f"distortion_model: {'none' if camera.is_pinhole else camera.model}\n"
        f"distortion: {list(camera.coefficients)!r}\n"
        f"# depth images: metres times {depth_factor:g}, 16 bit, 0 where there is none\n"
    )


def _pose_line(timestamp_s: float, world_from_cam: Floats) -> str:
    from scipy.spatial.transform import Rotation

    x, y, z = world_from_cam[:3, 3]
    qx, qy, qz, qw = Rotation.from_matrix(world_from_cam[:3, :3]).as_quat(canonical=True)
    return f"{timestamp_s:.6f} {x:.9f} {y:.9f} {z:.9f} {qx:.9f} {qy:.9f} {qz:.9f} {qw:.9f}\n"
