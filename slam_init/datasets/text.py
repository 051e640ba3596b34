"""Readers of the text tables of data sets, and their time stamps: checked, and converted to seconds.

Byte order marks, CRLF line ends, blank lines, ``#`` comments and trailing spaces are allowed. A broken line is an error
whose message names file and line.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeAlias

import numpy as np

from quest.geometry.quaternion import quaternion_from_matrix
from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside, read_regular
from slam_init.types.arrays import Floats
from slam_init.types.pose import Pose, Trajectory
from slam_init.types.time_stamps import TimeUnit, in_seconds, problem_of, time_unit, unit_notes

#: The place of a line for error messages (``file:line``), and its text.
Row = tuple[str, str]

# A million poses, in as many digits as a double has.
_MAX_BYTES = 200_000_000


#: Largest coordinate of a true position: the earth has 4e7 m around, and 1e10 holds it in millimetres.
_FARTHEST = 1e11


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
    for number, line in enumerate(text.splitlines(), start=1):
        yield f"{path}:{number}", line.strip()


def numbers(row: Row, fields: list[str], count: int, what: str) -> list[float]:
    """Parse the first ``count`` fields of a line as finite numbers."""
    with suppress(ValueError):
        values = [float(field) for field in fields[:count]]
        if len(values) == count and all(map(math.isfinite, values)):
            return values
    raise SourceError(f"{row[0]}: expected {what}, found {row[1][:60]!r}")


def trajectory(stamped: Iterable[tuple[float, Pose]]) -> Trajectory | None:
    """Make a trajectory from stamped poses.

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
        give = f"name the columns in a first line, as # {TUM_COLUMNS}"
        raise SourceError(f"{row[0]}: quaternion {q_wxyz} is not of unit norm: {give}")
    return Pose.from_quaternion(np.array(q_wxyz), _position(row[0], np.array(t)))


def pose_from_matrix(place: str, matrix: Floats) -> Pose:
    """Make a pose from a printed matrix. Its rotation is made exactly orthonormal.

    Shapes: ``matrix`` (3, 4).
    """
    R = matrix[:3, :3]
    if not _is_rotation(R):
        raise SourceError(f"{place}: the 3x3 part of the pose is not a rotation")
    return Pose.from_quaternion(quaternion_from_matrix(R), _position(place, matrix[:3, 3]))


def _is_rotation(R: Floats) -> bool:
    # The first condition holds back numbers whose squares overflow.
    return bool((np.abs(R) < 2).all() and np.allclose(R @ R.T, np.eye(3), atol=0.01) and np.linalg.det(R) > 0)


def _position(place: str, t: Floats) -> Floats:
    """A position of the ground truth, which is checked: squares of huge numbers are not finite."""
    if not (np.abs(t) <= _FARTHEST).all():
        raise SourceError(f"{place}: the position {t.tolist()} is no place on earth: give metres")
    return t


#: The columns of the format of TUM RGB-D.
TUM_COLUMNS = "timestamp tx ty tz qx qy qz qw"
#: Words before the axis in the names of columns, such as ``p_RS_R_x [m]``, ``q_w`` and ``pose.orientation.w``.
_WORDS = {
    "t": {"t", "p", "tran", "trans", "translation", "pos", "position", "location"},
    "q": {"q", "quat", "quaternion", "rot", "rotation", "ori", "orient", "orientation"},
}
_PARTS = ("tx", "ty", "tz", "qw", "qx", "qy", "qz")


#: A pose of a table; its time stamp is None where the table has none.
StampedPose: TypeAlias = tuple[float | None, Pose]
_MATRIX = "a matrix of 3x4 or 4x4 numbers"


def read_poses(
    path: str | os.PathLike[str], root: str | os.PathLike[str] | None, columns: str
) -> Iterator[StampedPose]:
    """Read a table of poses. The names of its header win over the positions that its format states.

    A line without a header may hold the seven numbers of a pose alone, or a matrix of 3x4 or 4x4 numbers, perhaps with
    a time stamp before it.

    * ``columns``: The names by position where no line names them. Those of the pose are ``tx ty tz`` and
      ``qw qx qy qz``, in any order. Further columns are ignored. Without any the lines are matrices.
    """
    names, named = columns.split(), False
    for row in read_lines(path, root):
        header = _names_in(row[1])
        if header:
            names, named = header, True
        elif row[1] and row[1][0] not in "#%":
            yield _pose_of_row(row, names, named)


def _names_in(line: str) -> list[str]:
    """The columns that a header names, other ones as empty text; none for a line that names no pose."""
    if "w" not in line.lower():
        return []
    without_units = re.sub(r"[\[(].*?[\])]", "", line.lower().lstrip("#% "))
    words = fields_of(("", without_units))
    names = [_name_of(word) for word in words]
    if not set(_PARTS) <= set(names):
        return []
    timed = (k for k, word in enumerate(words) if "time" in word or "stamp" in word)
    first = next(timed, 0)
    return [name or ("timestamp" if k == first else "") for k, name in enumerate(names)]


def _name_of(word: str) -> str:
    """A name of :data:`_PARTS` for the name of a column; empty for a column of something else."""
    before = set(re.findall("[a-z]+", word[:-1])) or {"t"}
    kind = next((kind for kind, words in _WORDS.items() if before & words), "")
    return kind + word[-1] if kind + word[-1:] in _PARTS else ""


def _pose_of_row(row: Row, names: list[str], named: bool) -> StampedPose:
    fields = fields_of(row)
    if not named and len(fields) in (12, 13, 16, 17):
        stamped = len(fields) % 4
        matrix = np.array(numbers(row, fields[stamped:], 12, _MATRIX)).reshape(3, 4)
        if not names or _is_rotation(matrix[:, :3]):
            return numbers(row, fields, 1, _MATRIX)[0] if stamped else None, pose_from_matrix(row[0], matrix)
    if not names:
        raise SourceError(f"{row[0]}: expected {_MATRIX}, found {row[1][:60]!r}")
    if named and len(fields) != len(names):
        raise SourceError(f"{row[0]}: has {len(fields)} columns, and the header names {len(names)}: name each column")
    if len(fields) == len(_PARTS) and not named:
        names = [name for name in names if name in _PARTS]
    wanted = [name for name in ("timestamp", *_PARTS) if name in names]
    chosen = [fields[names.index(name)] for name in wanted if names.index(name) < len(fields)]
    values = dict(zip(wanted, numbers(row, chosen, len(wanted), " ".join(names)), strict=True))
    t, q_wxyz = [values[name] for name in _PARTS[:3]], [values[name] for name in _PARTS[3:]]
    return values.get("timestamp"), pose_from_quaternion(row, t, q_wxyz)


def fields_of(row: Row) -> list[str]:
    """Split a line at its semicolons or commas, or at white space where it has none."""
    separator = next((one for one in ";," if one in row[1]), None)
    return [field.strip() for field in row[1].split(separator)]


def check_count(table: str | os.PathLike[str], rows: Sequence[object], what: str, paths: Sequence[Path]) -> None:
    """Check that a table has one row for each image.

    * ``what``: The rows, for the message: ``poses``.
    """
    if len(rows) != len(paths):
        raise SourceError(f"{table}: {len(rows)} {what} for {len(paths)} images in {paths[0].parent.name}")


def read_poses_of(paths: Sequence[Path], table: Path, root: str | os.PathLike[str], columns: str = "") -> list[Pose]:
    """Read the poses of images, one for each, from a table without time stamps; see :func:`read_poses`."""
    poses = [pose for _, pose in read_poses(table, root, columns)]
    check_count(table, poses, "poses", paths)
    return poses


def read_trajectory(
    path: str | os.PathLike[str],
    root: str | os.PathLike[str] | None = None,
    columns: str = TUM_COLUMNS,
    body_from_cam: Pose | None = None,
) -> Trajectory | None:
    """Read a trajectory; by default in the format of TUM RGB-D.

    * ``root``: The folder of the source; see :func:`slam_init.system.regular_file.check_inside`.
    * ``columns``: See :func:`read_poses`; one of them is ``timestamp``.
    * ``body_from_cam``: Pose of the camera in the body whose poses the file states; by default they are the same.
    * Returns: Time stamps as they stand in the file and poses world_from_cam in the unit of the file; None if the file
      holds no pose.
    """
    rows = list(read_poses(path, root, columns))
    if not rows:
        return None
    stamps = stamps_of(rows)
    if stamps is None:
        raise SourceError(f"{path}: its {len(rows)} poses have no time stamps: state the time of each")
    poses = (pose @ body_from_cam if body_from_cam else pose for _, pose in rows)
    return trajectory(zip(stamps, poses, strict=True))


def stamps_of(rows: Sequence[StampedPose]) -> list[float] | None:
    """The time stamps of poses; None where they have none."""
    stamps = [stamp for stamp, _ in rows if stamp is not None]
    return stamps if len(stamps) == len(rows) else None


# -- time stamps -----------------------------------------------------------------------------------


#: A pose belongs to an image if their time stamps differ by no more than this.
TOLERANCE_S = 0.02


def stamp_of(row: Row, fields: list[str], what: str) -> float:
    """Parse the first field of a line as a time stamp in any unit."""
    (stamp,) = numbers(row, fields, 1, what)
    if problem := problem_of(stamp):
        raise SourceError(f"{row[0]}: time stamp {fields[0][:40]} {problem}")
    return stamp


def image_times(
    stamps: Sequence[float], places: Sequence[str], stated: TimeUnit = TimeUnit.SECONDS
) -> tuple[Floats, tuple[str, ...]]:
    """Check that the time stamps of images increase, and convert them to seconds.

    Shapes: returns ``timestamps_s`` (N,).
    """
    raw = np.array(stamps, float)
    _check(raw, raw, places)
    unit = time_unit(raw, stated)
    times_s = in_seconds(raw, unit)
    _check(times_s, raw, places)
    return times_s, unit_notes("the time stamps", unit, stated)


def _check(times: Floats, raw: Floats, places: Sequence[str]) -> None:
    """Raise the problem of the first time that has one; the message states the stamp that it comes from."""
    previous = [None, *times.tolist()]
    for place, stamp, time, before in zip(places, raw.tolist(), times.tolist(), previous, strict=False):
        if problem := problem_of(time, before):
            shown = f"{stamp:.0f}" if stamp.is_integer() else repr(stamp)
            raise SourceError(f"{place}: time stamp {shown} {problem}")


def truth_on_clock(
    truth: Trajectory | None, timestamps_s: Floats, stated: TimeUnit = TimeUnit.SECONDS
) -> tuple[Trajectory | None, tuple[str, ...]]:
    """Convert the stamps of a true trajectory to seconds on the clock of the images.

    Poses may come at any rate, so that their step has no meaning. Their unit is the one in which most images have a
    true pose; the stated one if no other gives more.

    Shapes: ``timestamps_s`` (N,).
    """
    if truth is None:
        return None, ()
    matched = {unit: _matched(in_seconds(truth.timestamps_s, unit), timestamps_s) for unit in (stated, *TimeUnit)}
    unit = max(matched, key=matched.__getitem__)  # of equal ones the first, which is the stated one
    notes = unit_notes("the time stamps of the ground truth", unit, stated)
    if unit == TimeUnit.SECONDS:
        return truth, notes
    stamps = in_seconds(truth.timestamps_s, unit).tolist()
    return trajectory(zip(stamps, truth.world_from_cam, strict=True)), notes


def line_by_line(stamps: Floats, timestamps_s: Floats) -> bool:
    """Whether the stamps of poses, in any unit, differ from the times of the images by an offset alone.

    Shapes: ``stamps`` (M,), ``timestamps_s`` (N,).
    """
    if len(stamps) != len(timestamps_s):
        return False
    passed_s, since_first = timestamps_s - timestamps_s[0], stamps - stamps[0]
    return any((np.abs(in_seconds(since_first, unit) - passed_s) <= TOLERANCE_S).all() for unit in TimeUnit)


def _matched(truth_s: Floats, timestamps_s: Floats) -> int:
    """How many images have a true pose near in time."""
    bounded = np.concatenate([[-np.inf], truth_s, [np.inf]])
    after = np.searchsorted(truth_s, timestamps_s)
    nearest = np.minimum(timestamps_s - bounded[after], bounded[after + 1] - timestamps_s)
    return int((nearest <= TOLERANCE_S).sum())
