"""The row of a trial, and ``trials.jsonl``: each row is written at once, so that a killed run can be resumed."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal, TypeAlias

from pydantic import TypeAdapter, ValidationError

from slam_init.errors import OutputError
from slam_init.output.folder import writing
from slam_init.output.plain_json import Json

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
    #: Error of the direction of the baseline in degrees; None if the direction is not evaluated.
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
    #: The criteria of the outcome in words (:attr:`slam_init.compare.criteria.Criteria.rule`); None in a row of a
    #: version without this column.
    evaluated_by: str | None = None
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
    #: Probability that the map is wrong by the model of an audit of its poses with the tracks of the trial, in place of
    #: what the method states. None where no audit was asked for, and where too few tracks are shared.
    audited_risk: float | None = None

    @property
    def key(self) -> Key:
        """Return what names the trial; rows are sorted by it."""
        return self.source, self.method, self.start

    def text(self) -> str:
        """Return the line of the row in ``trials.jsonl``. A number that is not finite is a ValueError."""
        return json.dumps(dataclasses.asdict(self), allow_nan=False)


#: Columns of ``results.csv``: the names of the fields of :class:`TrialRow`, with their types.
COLUMNS: dict[str, str] = {field.name: str(field.type) for field in dataclasses.fields(TrialRow)}
#: Reads a line of ``trials.jsonl``, which may come from another version: unknown columns are ignored.
_ROW = TypeAdapter(TrialRow)
#: Version 2 added ``kept_truth``, ``suspected_focal_factor`` and the options of the methods.
_SCHEMA = 3


class Journal:
    """A file with one row per line; the first line holds the settings under which the rows were computed.

    * ``path``: An existing file is continued. Its last line is removed if it is incomplete.
    * ``settings``: Settings that must be equal for all rows.
    * ``is_current``: Takes a row and returns whether it is valid; all rows by default. Other rows are passed over, so
      that their trials are run again. If a trial has several rows, the last one is valid.
    """

    def __init__(
        self, path: Path, settings: Mapping[str, Json], is_current: Callable[[TrialRow], bool] = lambda _: True
    ) -> None:
        self.rows: dict[Key, TrialRow] = {}
        self._path = path
        header: dict[str, Json] = {"schema": _SCHEMA, **settings}
        with writing(path):
            self._file: IO[bytes] = path.open("a+b")
            end = self._read(header, is_current)
            self._file.truncate(end)
            if end == 0:
                self._write(json.dumps(header, allow_nan=False))

    def append(self, row: TrialRow) -> None:
        """Write a row; after this call the row survives the end of the process."""
        self._write(row.text())
        self.rows[row.key] = row

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        # After a failed write, the rest of the buffer fails again; its error is raised already.
        with suppress(OSError):
            os.fsync(self._file.fileno())
            self._file.close()

    def _write(self, line: str) -> None:
        with writing(self._path):
            self._file.write(line.encode() + b"\n")
            self._file.flush()

    def _read(self, header: Mapping[str, Json], is_current: Callable[[TrialRow], bool]) -> int:
        """Find the rows; return the position of the end of the last complete line."""
        end = self._file.seek(0)
        for number, line in enumerate(self._file, 1):
            # Incomplete: the process was killed while it wrote this line. After a power loss the line may be zeros.
            if not line.endswith(b"\n") or line.startswith(b"\0"):
                break
            end += len(line)
            if number == 1:
                self._check(line, header)
                continue
            try:
                row = _ROW.validate_json(line, strict=True)
            except ValidationError:
                raise OutputError(f"{self._path}, line {number} is damaged: give another --out") from None
            if is_current(row):
                self.rows[row.key] = row
        return end

    def _check(self, line: bytes, header: Mapping[str, Json]) -> None:
        """Refuse a file whose rows were computed under other settings."""
        try:
            found = dict(json.loads(line))
        except (ValueError, TypeError, RecursionError):
            raise OutputError(f"{self._path}, line 1 is damaged: give another --out") from None
        if found.get("schema") != _SCHEMA:
            raise OutputError(f"{self._path} was written by another version of slam-init: give another --out")
        for name, value in header.items():
            if found.get(name) != value:
                other = f"other {name}" if isinstance(value, dict) else f"{name} {found.get(name)!r}, not {value!r}"
                raise OutputError(f"{self._path} holds trials with {other}: give another --out")
