"""The row of a trial, and ``trials.jsonl``: each row is written at once, so that a killed run can be resumed."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal, TypeAlias

from slam_init.errors import OutputError
from slam_init.output.plain_json import Json, parsed

#: ``accepted``: the method found a map, and there is no ground truth to compare the map with. For the other outcomes
#: see :mod:`slam_init.compare`.
Outcome: TypeAlias = Literal["correct", "false", "accepted", "none", "error"]

#: Label of the source, method, start frame.
Key = tuple[str, str, int]


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialRow:
    """The result of a trial, with the fields in the order of the columns of ``results.csv``.

    A field is None if the trial has no such value. A trial without a map has no values of a map, and a trial that ended
    in an error has only the values that were known before it ran. The errors are those of the worst keyframe, relative
    to the first keyframe. "Before" means before bundle adjustment. Only the fields that end in ``_ms`` or ``_mb``
    differ from run to run.
    """

    #: Label of the source.
    source: str
    #: Name of the method.
    method: str
    #: Start frame, as an absolute index.
    start: int
    #: How the trial ended.
    outcome: Outcome
    #: Why there is no map, for example ``low_parallax``; the message for an error.
    reason: str | None = None
    #: Number of frames that were read when the map was accepted.
    frames_to_accept: int | None = None
    #: Rotation error of the map in degrees.
    rotation_error_deg: float | None = None
    #: Error of the direction of the baseline in degrees; None if the direction is not judged.
    direction_error_deg: float | None = None
    #: Scene of the source. Trials of one scene are counted together.
    group: str
    #: Whether the map is correct by the strict bounds; None for an error.
    strict: bool | None = None
    #: Largest number of frames that the trial could read.
    frames_limit: int
    #: Seconds of video from the start frame to the frame at which the map was accepted.
    seconds_to_accept: float | None = None
    #: Root mean square position error of the keyframes after alignment by a similarity, divided by the length of the
    #: true path.
    ate: float | None = None
    #: rotation_error_before_deg, direction_error_before_deg, ate_before: The same errors before bundle adjustment.
    rotation_error_before_deg: float | None = None
    direction_error_before_deg: float | None = None
    ate_before: float | None = None
    #: Share of the landmarks that are observed within 3 px of their projection in the following frames, 0 to 1.
    survival: float | None = None
    #: Median relative error of the depths after median alignment.
    depth_error: float | None = None
    #: Share of the pairs of landmarks whose depths are in the wrong order, 0 to 1.
    depth_order_error: float | None = None
    #: Number of landmarks.
    landmarks: int | None = None
    #: Absolute indices of the keyframes, separated by spaces.
    keyframes: str | None = None
    #: Median parallax of the landmarks in degrees.
    parallax_deg: float | None = None
    #: Root mean square of the reprojection errors in pixels.
    reprojection_rmse_px: float | None = None
    #: Number of attempts in the log of the result.
    attempts: int | None = None
    #: Reason that the scene should give, for example ``pure_rotation``; None if a map is possible.
    injected_cause: str | None = None
    #: Whether the trial ended with this reason; None if the scene has no such reason.
    reason_right: bool | None = None
    #: For a trial that ended with ``ambiguous_plane``: whether one of its stored hypotheses is correct. None for
    #: other trials, and if there is no ground truth.
    kept_truth: bool | None = None
    #: Some attempts estimate that the focal length is wrong. The value is the median of their estimates, divided by
    #: the stated focal length.
    suspected_focal_factor: float | None = None
    #: The same figure as the result reports it to the user, which takes several attempts that agree.
    reported_focal_factor: float | None = None
    #: Radial distortion that the notes of the run say the calibration lacks.
    reported_distortion: float | None = None
    #: frame_median_ms, frame_p95_ms: Median and 95th percentile of the times of the frames, in milliseconds.
    frame_median_ms: float | None = None
    frame_p95_ms: float | None = None
    #: Median time of the frames with an attempt, in milliseconds.
    attempt_median_ms: float | None = None
    #: Time of the whole trial in milliseconds, with opening the source and measuring the result.
    trial_ms: float | None = None
    #: Peak resident memory of the process of the trial in MB.
    peak_memory_mb: float | None = None
    #: The criteria of the outcome in words (:attr:`slam_init.compare.judging.Criteria.rule`); None in a row of a
    #: version without this column.
    judged_by: str | None = None
    #: Stated probability that the accepted map is wrong. None for a method that states no risk, and in a row of a
    #: version without this column.
    risk: float | None = None
    #: rotation_sigma_deg, direction_sigma_deg: Stated standard deviations of the rotation and of the direction of the
    #: baseline of the pair of the accepted map, in degrees, each about its most uncertain axis. None as for the risk.
    rotation_sigma_deg: float | None = None
    direction_sigma_deg: float | None = None
    #: pair_rotation_error_deg, pair_direction_error_deg: Errors of this pair in degrees, as those of the map but
    #: without its further keyframes. None as for the risk.
    pair_rotation_error_deg: float | None = None
    pair_direction_error_deg: float | None = None
    #: Probability that the map is wrong, by an audit of its poses with the tracks of the trial, in place of what the
    #: method states. None where no audit was asked for, and where too few tracks are shared.
    audited_risk: float | None = None

    @property
    def key(self) -> Key:
        """Return what names the trial; rows are sorted by it."""
        return self.source, self.method, self.start

    def values(self) -> tuple[str | int | float | bool | None, ...]:
        """Return the values in the order of :data:`COLUMNS`."""
        return tuple(getattr(self, name) for name in COLUMNS)


#: Columns of ``results.csv``: the names of the fields of :class:`TrialRow`.
COLUMNS: tuple[str, ...] = tuple(field.name for field in dataclasses.fields(TrialRow))


def row_text(row: TrialRow) -> str:
    """Return the line of a row in ``trials.jsonl``.

    * Returns: A JSON object with the keys :data:`COLUMNS`, without a line break.
    """
    return json.dumps(dict(zip(COLUMNS, row.values(), strict=True)), allow_nan=False)


def parse_row(line: str | bytes) -> TrialRow:
    """Read a line of ``trials.jsonl``. The line may come from another version of the program."""
    return checked_row(parsed(TrialRow, line))


def checked_row(row: TrialRow) -> TrialRow:
    """Check the texts of a row that may come from anywhere."""
    if row.keyframes is not None and not _KEYFRAMES.fullmatch(row.keyframes):
        raise ValueError(f"keyframes is {row.keyframes!r}")
    return row


#: Absolute indices of frames, separated by spaces.
_KEYFRAMES = re.compile(r"\d{1,18}( \d{1,18})*")


#: Version 2 added ``kept_truth``, ``suspected_focal_factor`` and the options of the methods.
_SCHEMA = 2
#: Interval of the syncs to the disk.
_SYNC_S = 1.0


class Journal:
    """A file with one row per line; the first line holds the settings under which the rows were computed.

    Memory holds only the key of each row and the position of the row in the file.

    * ``path``: An existing file is continued. Its last line is removed if it is incomplete.
    * ``settings``: Settings that must be equal for all rows.
    * ``is_current``: Takes a row and returns whether it is valid; all rows by default. Other rows are passed over, so
      that their trials are run again. If a trial has several rows, the last one is valid.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        settings: Mapping[str, Json],
        is_current: Callable[[TrialRow], bool] = lambda _: True,
    ) -> None:
        self._path = path = Path(path)
        self._is_current = is_current
        self._offsets: dict[Key, int] = {}
        self._synced_s = 0.0
        header: dict[str, Json] = {"schema": _SCHEMA, **settings}
        try:
            self._file: IO[bytes] = path.open("r+b" if path.exists() else "w+b")
            end = self._read(header)
            self._file.truncate(end)
            self._file.seek(end)
            if end == 0:
                self._write(json.dumps(header, allow_nan=False))
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror or error}: give another --out") from error

    def __contains__(self, key: Key) -> bool:
        return key in self._offsets

    def __len__(self) -> int:
        return len(self._offsets)

    def append(self, row: TrialRow) -> None:
        """Write a row; after this call the row survives the end of the process, and a second later a power loss."""
        self._offsets[row.key] = self._file.seek(0, 2)
        self._write(row_text(row))

    def rows(self, wanted: Callable[[Key], bool] = lambda _: True) -> Iterator[TrialRow]:
        """Read rows back, sorted by source, method and start.

        * ``wanted``: Takes the key of a row and returns whether the row is read; all rows by default.
        """
        for key in sorted(self._offsets):
            if wanted(key):
                self._file.seek(self._offsets[key])
                yield parse_row(self._file.readline())

    def close(self) -> None:
        """Close the file."""
        # After a failed write, the rest of the buffer fails again; its error is raised already.
        with suppress(OSError):
            os.fsync(self._file.fileno())
            self._file.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, line: str) -> None:
        try:
            self._file.write(line.encode() + b"\n")
            self._file.flush()
            # A sync takes milliseconds, and many trials take no longer.
            if time.monotonic() - self._synced_s > _SYNC_S:
                os.fsync(self._file.fileno())
                self._synced_s = time.monotonic()
        except OSError as error:
            raise OutputError(f"cannot write {self._path}: {error.strerror or error}: make room") from error

    def _read(self, header: Mapping[str, Json]) -> int:
        """Find the rows; return the position of the end of the last complete line."""
        end = 0
        for number, line in enumerate(self._file):
            # Incomplete: the process was killed while it wrote this line. After a power loss the line may be zeros.
            if not line.endswith(b"\n") or line.startswith(b"\0"):
                break
            try:
                if number == 0:
                    self._check(_parse_settings(line), header)
                elif self._is_current(row := parse_row(line)):
                    self._offsets[row.key] = end
                else:
                    self._offsets.pop(row.key, None)
            except ValueError:
                raise OutputError(f"{self._path}, line {number + 1} is damaged: give another --out") from None
            end += len(line)
        return end

    def _check(self, found: Mapping[str, Json], header: Mapping[str, Json]) -> None:
        if found.get("schema") != _SCHEMA:
            raise OutputError(f"{self._path} was written by another version of slam-init: give another --out")
        for name, value in header.items():
            if found.get(name) == value:
                continue
            if isinstance(value, dict):
                raise OutputError(f"{self._path} holds trials with other {name}: give another --out")
            raise OutputError(
                f"{self._path} holds trials with {name} {found.get(name)!r}, not {value!r}: give another --out"
            )


def read_journal(path: str | os.PathLike[str]) -> Iterator[TrialRow]:
    """Read the rows of a finished comparison in the order of the file. The last row of a trial is valid."""
    with Path(path).open("rb") as file:
        next(file)  # the settings
        for number, line in enumerate(file, 2):
            try:
                yield parse_row(line)
            except ValueError:
                raise OutputError(f"{path}, line {number} is damaged: run the comparison again") from None


def _parse_settings(line: bytes) -> dict[str, Json]:
    content = json.loads(line)
    if not isinstance(content, dict):
        raise ValueError("not a JSON object")
    return content
