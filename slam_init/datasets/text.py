"""Text tables of data sets, read with tolerance for their form and none for their content.

Byte order marks, CRLF, blank lines, ``#`` comments and trailing spaces pass; a broken line is an error that
names file and line.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from quest.geometry.quaternion import quaternion_from_matrix
from slam_init.errors import SourceError
from slam_init.types.arrays import Floats
from slam_init.types.pose import Pose, Trajectory

__all__ = [
    "Row",
    "numbers",
    "pose_from_matrix",
    "pose_from_quaternion",
    "read_rows",
    "read_tum_trajectory",
    "trajectory",
]

#: Place for error messages (``file:line``) and the text of a line.
Row = tuple[str, str]


def read_rows(path: Path) -> Iterator[Row]:
    """Yield ``(place, text)`` of the lines that hold something.

    Raises
    ------
    SourceError
        Where the file is not readable as text.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise SourceError(f"{path}: not a text file") from None
    except OSError as error:
        raise SourceError(f"{path}: cannot be read ({error.strerror})") from None
    for number, line in enumerate(text.splitlines(), start=1):
        stripped = line.strip()
        if stripped and not stripped.startswith("#"):
            yield f"{path}:{number}", stripped


def numbers(row: Row, fields: list[str], count: int, what: str) -> list[float]:
    """The first ``count`` fields as finite numbers.

    Raises
    ------
    SourceError
        Names the line and what was expected in it.
    """
    place, text = row
    try:
        values = [float(field) for field in fields[:count]]
    except ValueError:
        values = []
    if len(values) < count or not all(math.isfinite(value) for value in values):
        raise SourceError(f"{place}: expected {what}, found {text[:60]!r}")
    return values


def trajectory(stamped: list[tuple[float, Pose]]) -> Trajectory | None:
    """A trajectory of stamped poses in any order (the first of equal stamps is kept), or None."""
    unique: dict[float, Pose] = {}
    for timestamp_s, pose in stamped:
        unique.setdefault(timestamp_s, pose)
    stamps = sorted(unique)
    return Trajectory(np.array(stamps), tuple(unique[stamp] for stamp in stamps)) if stamps else None


def pose_from_quaternion(row: Row, t: list[float], q_wxyz: list[float]) -> Pose:
    """A pose from file numbers; an impossible quaternion is a :class:`SourceError`."""
    # Files print 4 to 9 digits; a norm further from 1 means that the columns are something else.
    if abs(math.hypot(*q_wxyz) - 1) > 0.01:
        raise SourceError(f"{row[0]}: quaternion {q_wxyz} is not of unit norm")
    return Pose.from_quaternion(np.array(q_wxyz), np.array(t))


def pose_from_matrix(place: str, matrix: Floats) -> Pose:
    """A pose from a printed (3, 4) or (4, 4) matrix, its rotation made exactly orthonormal."""
    R = matrix[:3, :3]
    if not (np.allclose(R @ R.T, np.eye(3), atol=0.01) and np.linalg.det(R) > 0):
        raise SourceError(f"{place}: the 3x3 part of the pose is not a rotation")
    return Pose.from_quaternion(quaternion_from_matrix(R), matrix[:3, 3])


def read_tum_trajectory(path: Path) -> Trajectory | None:
    """``timestamp tx ty tz qx qy qz qw`` (world_from_cam), in seconds and the units of the file."""
    stamped = []
    for row in read_rows(path):
        fields = row[1].replace(",", " ").split()
        stamp, tx, ty, tz, qx, qy, qz, qw = numbers(row, fields, 8, "timestamp tx ty tz qx qy qz qw")
        stamped.append((stamp, pose_from_quaternion(row, [tx, ty, tz], [qw, qx, qy, qz])))
    return trajectory(stamped)
