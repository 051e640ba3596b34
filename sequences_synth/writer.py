"""Write a sequence as a folder in the layout of TUM RGB-D."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sequences_synth.arrays import Image
from sequences_synth.sequence import SynthSequence


def write_tum(
    sequence: SynthSequence, folder: str | os.PathLike[str], progress: Callable[[int], None] | None = None
) -> None:
    """Write a sequence in the layout of TUM RGB-D.

    The folder holds:

    * ``rgb.txt``: time stamp, file;
    * ``groundtruth.txt``: time stamp, tx ty tz, qx qy qz qw (world_from_cam, metres);
    * ``camera.yaml``: the stated camera;
    * ``images/000000.png`` and so on: BGR.

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
    from scipy.spatial.transform import Rotation

    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileExistsError(f"{folder} exists already: name a new or an empty folder")
    (folder / "images").mkdir(parents=True)
    for index in range(len(sequence)):
        image, _ = sequence.render(index)
        _write_png(folder / "images" / f"{index:06d}.png", image)
        if progress is not None:
            progress(index + 1)

    times, poses = sequence.timestamps_s, sequence.poses
    (folder / "camera.yaml").write_text(_camera_text(sequence))
    header = "camera-to-world (T_wc), quaternion order x y z w, optical frame: x right, y down, z forward\n"
    header += "timestamp tx ty tz qx qy qz qw"
    rows = np.column_stack([times, poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)])
    np.savetxt(folder / "groundtruth.txt", rows, ["%.6f", *7 * ["%.9f"]], header=header)
    lines = "".join(f"{time:.6f} images/{index:06d}.png\n" for index, time in enumerate(times))
    (folder / "rgb.txt").write_text("# timestamp filename\n" + lines)


def _write_png(path: Path, image: Image) -> None:
    import cv2

    # Compression level 1: noise cannot be compressed, and the default level takes three times as long.
    # OpenCV's own writer does not distinguish a full disk from another failure.
    encoded, png = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not encoded:
        raise OSError(f"cannot encode {path}")
    path.write_bytes(png.tobytes())


def _camera_text(sequence: SynthSequence) -> str:
    camera = sequence.camera
    return (
        f"model: {camera.model}\n"
        f"width: {camera.width}\nheight: {camera.height}\n"
        f"fx: {camera.fx!r}\nfy: {camera.fy!r}\ncx: {camera.cx!r}\ncy: {camera.cy!r}\n"
        f"distortion_model: {'none' if camera.is_pinhole else camera.model}\n"
        f"distortion: {list(camera.coefficients)!r}\n"
    )
