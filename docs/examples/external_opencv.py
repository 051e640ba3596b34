"""An external method in 50 lines of OpenCV: corners, optical flow, ``findEssentialMat``, ``recoverPose``.

A command that runs it::

    slam-init run FOLDER --method \
      'opencv=command:python docs/examples/external_opencv.py {images} {times} {camera} {out}'

It uses nothing of this project but the reader of the calibration, as a start for a wrapper of your own. It takes the
first frame as reference, and accepts the first frame in which 50 points have a median parallax of two degrees.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from slam_init.calibration.files import load_camera
from slam_init.types.arrays import Floats, Image

_MIN_POINTS, _MIN_PARALLAX_DEG = 50, 2.0


def main(arguments: list[str]) -> int:
    """Initialize from a folder of frames.

    * ``arguments``: Folder of the frames, file of the time stamps, calibration, folder of the results.
    """
    import cv2

    images, times, calibration, out = map(Path, arguments)
    camera = load_camera(calibration)
    lines = [line.split() for line in times.read_text().splitlines()]
    previous = _grey(images / lines[0][1])
    corners = cv2.goodFeaturesToTrack(previous, 800, 0.01, 8)
    if corners is None:
        return 0
    start = current = corners.reshape(-1, 2)
    for count, (stamp, name) in enumerate(lines[1:], 2):
        image = _grey(images / name)
        following, found, _ = cv2.calcOpticalFlowPyrLK(previous, image, current, np.empty_like(current))
        kept = found.ravel() == 1
        start, current, previous = start[kept], following[kept], image
        if len(current) < _MIN_POINTS:
            return 0
        rays1, rays2 = camera.bearings(start), camera.bearings(current)
        x1, x2 = rays1[:, :2] / rays1[:, 2:], rays2[:, :2] / rays2[:, 2:]
        E, mask = cv2.findEssentialMat(x1, x2, np.eye(3), cv2.RANSAC, 0.999, 1.5 / camera.focal_px)
        if E is None or E.shape != (3, 3):
            continue
        inliers = mask.ravel() > 0
        in_front, R, t, _ = cv2.recoverPose(E, x1[inliers], x2[inliers])
        cosines = np.sum((rays1[inliers] @ R.T) * rays2[inliers], axis=1)
        parallax_deg = float(np.degrees(np.median(np.arccos(np.clip(cosines, -1, 1)))))
        if in_front >= _MIN_POINTS and parallax_deg >= _MIN_PARALLAX_DEG:
            pose = _world_from_cam(np.asarray(R, float), np.asarray(t, float).ravel())
            (out / "trajectory.txt").write_text(f"{lines[0][0]} 0 0 0 0 0 0 1\n{stamp} {pose}\n")
            (out / "frames_read.txt").write_text(str(count))
            return 0
    return 0


def _grey(path: Path) -> Image:
    import cv2

    return np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)


def _world_from_cam(R: Floats, t: Floats) -> str:
    """Write the inverse of ``cam_from_world`` as ``tx ty tz qx qy qz qw``."""
    import cv2

    vector = cv2.Rodrigues(R.T)[0].ravel()
    angle = float(np.linalg.norm(vector))
    xyz = vector * (np.sin(angle / 2) / angle if angle > 0 else 0.5)
    return " ".join(f"{value:.12g}" for value in (*(-R.T @ t), *xyz, np.cos(angle / 2)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
