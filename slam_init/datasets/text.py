"""Readers of the text tables of data sets.

Byte order marks, CRLF line ends, blank lines, ``#`` comments and trailing spaces are allowed. A broken line is an error
whose message names file and line.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from quest.geometry.quaternion import quaternion_from_matrix
from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside, read_regular
from slam_init.types.arrays import Floats
from slam_init.types.pose import Pose, Trajectory

#: The place of a line for error messages (``file:line``), and its text.
Row = tuple[str, str]

# A million poses, in as many digits as a double has.
_MAX_BYTES = 200_000_000


#: Largest coordinate of a true position: the earth has 4e7 m around, and 1e10 holds it in millimetres.
_FARTHEST = 1e11
#: Most lines of a table: true poses at 100 Hz for an hour and a half.
_MAX_LINES = 600_000


def read_rows(path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> Iterator[Row]:
    """Read the lines of a file, without blank lines and comments.

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    """
    for place, line in read_lines(path, root):
        if line and not line.startswith("#"):
            yield place, line


def read_lines(path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> Iterator[Row]:
    """Read all lines of a file, blank ones and comments too.

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    """
    path = Path(path)
    if root is not None:
        check_inside(path, root)
    try:
        text = read_regular(path, _MAX_BYTES, "a table of a sequence", SourceError).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise SourceError(f"{path}: not a text file") from None
    if text.count("\n") > _MAX_LINES:
        raise SourceError(f"{path}: has more than {_MAX_LINES} lines: split the sequence")
    for number, line in enumerate(text.splitlines(), start=1):
        yield f"{path}:{number}", line.strip()


def numbers(row: Row, fields: list[str], count: int, what: str) -> list[float]:
    """Parse the first ``count`` fields of a line as finite numbers."""
    place, text = row
    try:
        values = [float(field) for field in fields[:count]]
    except ValueError:
        values = []
    if len(values) < count or not all(math.isfinite(value) for value in values):
        raise SourceError(f"{place}: expected {what}, found {text[:60]!r}")
    return values


def trajectory(stamped: list[tuple[float, Pose]]) -> Trajectory | None:
    """Make a trajectory from stamped poses.

    Shapes: ``stamped`` (float, Pose).

    * ``stamped``: Time stamps in seconds and poses world_from_cam, in any order. Of poses with equal stamps the first
      is kept.
    """
    unique: dict[float, Pose] = {}
    for timestamp_s, pose in stamped:
        unique.setdefault(timestamp_s, pose)
    stamps = sorted(unique)
    return Trajectory(np.array(stamps), tuple(unique[stamp] for stamp in stamps)) if stamps else None


def pose_from_quaternion(row: Row, t: list[float], q_wxyz: list[float]) -> Pose:
    """Make a pose from a translation and a quaternion of a file."""
    # Files print 4 to 9 digits. A norm further from 1 means that the columns hold something else.
    if abs(math.hypot(*q_wxyz) - 1) > 0.01:
        raise SourceError(f"{row[0]}: quaternion {q_wxyz} is not of unit norm")
    return Pose.from_quaternion(np.array(q_wxyz), _position(row[0], np.array(t)))


def pose_from_matrix(place: str, matrix: Floats) -> Pose:
    """Make a pose from a printed matrix. Its rotation is made exactly orthonormal.

    Shapes: ``matrix`` (3, 4).
    """
    R = matrix[:3, :3]
    # The first condition holds back numbers whose squares overflow.
    if not ((np.abs(R) < 2).all() and np.allclose(R @ R.T, np.eye(3), atol=0.01) and np.linalg.det(R) > 0):
        raise SourceError(f"{place}: the 3x3 part of the pose is not a rotation")
    return Pose.from_quaternion(quaternion_from_matrix(R), _position(place, matrix[:3, 3]))


def _position(place: str, t: Floats) -> Floats:
    """A position of the ground truth, which is checked: squares of huge numbers are not finite."""
    if not (np.abs(t) <= _FARTHEST).all():
        raise SourceError(f"{place}: the position {t.tolist()} is no place on earth: give metres")
    return t


def read_tum_trajectory(path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> Trajectory | None:
    """Read a trajectory in the format of TUM RGB-D: lines of ``timestamp tx ty tz qx qy qz qw``.

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    * Returns: Time stamps as they stand in the file and poses world_from_cam in the unit of the file; None if the file
      holds no pose.
    """
    stamped = []
    for row in read_rows(path, root):
        fields = row[1].replace(",", " ").split()
        stamp, tx, ty, tz, qx, qy, qz, qw = numbers(row, fields, 8, "timestamp tx ty tz qx qy qz qw")
        stamped.append((stamp, pose_from_quaternion(row, [tx, ty, tz], [qw, qx, qy, qz])))
    return trajectory(stamped)
