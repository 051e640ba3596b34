"""The row of a trial: a line of ``trials.jsonl`` and of ``results.csv``."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args, get_type_hints

from slam_init.output.plain_json import Json

__all__ = ["COLUMNS", "Key", "Outcome", "TrialRow", "finite_json", "parse_row", "row_text"]

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

    Attributes
    ----------
    source : str
        Label of the source.
    method : str
        Name of the method.
    start : int
        Start frame, as an absolute index.
    outcome : Outcome
        How the trial ended.
    reason : str or None
        Why there is no map, for example ``low_parallax``; the message for an error.
    frames_to_accept : int or None
        Number of frames that were read when the map was accepted.
    rotation_error_deg : float or None
        Rotation error of the map in degrees.
    direction_error_deg : float or None
        Error of the direction of the baseline in degrees; None if the direction is not judged.
    group : str
        Scene of the source. Trials of one scene are counted together.
    strict : bool or None
        Whether the map is correct by the strict bounds; None for an error.
    frames_limit : int
        Largest number of frames that the trial could read.
    seconds_to_accept : float or None
        Seconds of video from the start frame to the frame at which the map was accepted.
    ate : float or None
        Root mean square position error of the keyframes after alignment by a similarity, divided by the length of the
        true path.
    rotation_error_before_deg, direction_error_before_deg, ate_before : float or None
        The same errors before bundle adjustment.
    survival : float or None
        Share of the landmarks that are observed within 3 px of their projection in the following frames, 0 to 1.
    depth_error : float or None
        Median relative error of the depths after median alignment.
    depth_order_error : float or None
        Share of the pairs of landmarks whose depths are in the wrong order, 0 to 1.
    landmarks : int or None
        Number of landmarks.
    keyframes : str or None
        Absolute indices of the keyframes, separated by spaces.
    parallax_deg : float or None
        Median parallax of the landmarks in degrees.
    reprojection_rmse_px : float or None
        Root mean square of the reprojection errors in pixels.
    attempts : int or None
        Number of attempts in the log of the result.
    injected_cause : str or None
        Reason that the scene should give, for example ``pure_rotation``; None if a map is possible.
    reason_right : bool or None
        Whether the trial ended with this reason; None if the scene has no such reason.
    kept_truth : bool or None
        For a trial that ended with ``ambiguous_plane``: whether one of its stored hypotheses is correct. None for other
        trials, and if there is no ground truth.
    suspected_focal_factor : float or None
        Some attempts estimate that the focal length is wrong. The value is the median of their estimates, divided by
        the stated focal length.
    reported_distortion : float or None
        Radial distortion that the notes of the run say the calibration lacks.
    reported_focal_factor : float or None
        The same figure as the result reports it to the user, which takes several attempts that agree.
    frame_median_ms, frame_p95_ms : float or None
        Median and 95th percentile of the times of the frames, in milliseconds.
    attempt_median_ms : float or None
        Median time of the frames with an attempt, in milliseconds.
    trial_ms : float or None
        Time of the whole trial in milliseconds, with opening the source and measuring the result.
    peak_memory_mb : float or None
        Peak resident memory of the process of the trial in MB.
    judged_by : str or None
        The criteria of the outcome in words (:attr:`slam_init.compare.judging.Criteria.rule`); None in a row of a
        version without this column.
    risk : float or None
        Stated probability that the accepted map is wrong. None for a method that states no risk, and in a row of a
        version without this column.
    rotation_sigma_deg, direction_sigma_deg : float or None
        Stated standard deviations of the rotation and of the direction of the baseline of the pair of the accepted map,
        in degrees, each about its most uncertain axis. None as for the risk.
    pair_rotation_error_deg, pair_direction_error_deg : float or None
        Errors of this pair in degrees, as those of the map but without its further keyframes. None as for the risk.
    """

    source: str
    method: str
    start: int
    outcome: Outcome
    reason: str | None = None
    frames_to_accept: int | None = None
    rotation_error_deg: float | None = None
    direction_error_deg: float | None = None
    group: str
    strict: bool | None = None
    frames_limit: int
    seconds_to_accept: float | None = None
    ate: float | None = None
    rotation_error_before_deg: float | None = None
    direction_error_before_deg: float | None = None
    ate_before: float | None = None
    survival: float | None = None
    depth_error: float | None = None
    depth_order_error: float | None = None
    landmarks: int | None = None
    keyframes: str | None = None
    parallax_deg: float | None = None
    reprojection_rmse_px: float | None = None
    attempts: int | None = None
    injected_cause: str | None = None
    reason_right: bool | None = None
    kept_truth: bool | None = None
    suspected_focal_factor: float | None = None
    reported_focal_factor: float | None = None
    reported_distortion: float | None = None
    frame_median_ms: float | None = None
    frame_p95_ms: float | None = None
    attempt_median_ms: float | None = None
    trial_ms: float | None = None
    peak_memory_mb: float | None = None
    judged_by: str | None = None
    risk: float | None = None
    rotation_sigma_deg: float | None = None
    direction_sigma_deg: float | None = None
    pair_rotation_error_deg: float | None = None
    pair_direction_error_deg: float | None = None

    @property
    def key(self) -> Key:
        """Return what names the trial; rows are sorted by it.

        Returns
        -------
        (str, str, int)
            Label of the source, method, start frame.
        """
        return self.source, self.method, self.start

    def values(self) -> tuple[str | int | float | bool | None, ...]:
        """Return the values in the order of :data:`COLUMNS`.

        Returns
        -------
        tuple of str, int, float, bool or None
        """
        return tuple(getattr(self, name) for name in COLUMNS)


#: Columns of ``results.csv``: the names of the fields of :class:`TrialRow`.
COLUMNS: tuple[str, ...] = tuple(field.name for field in dataclasses.fields(TrialRow))


def row_text(row: TrialRow) -> str:
    """Return the line of a row in ``trials.jsonl``.

    Parameters
    ----------
    row : TrialRow

    Returns
    -------
    str
        A JSON object with the keys :data:`COLUMNS`, without a line break.

    Raises
    ------
    ValueError
        If a number is not finite.
    """
    return json.dumps(dict(zip(COLUMNS, row.values(), strict=True)), allow_nan=False)


def parse_row(line: str | bytes) -> TrialRow:
    """Read a line of ``trials.jsonl``. The line may come from another version of the program.

    Parameters
    ----------
    line : str or bytes
        JSON object. Unknown keys are ignored, and a missing key of an optional value means None.

    Returns
    -------
    TrialRow

    Raises
    ------
    ValueError
        If the line is not a JSON object, a value that every row has is missing, or a value has the wrong type.
    """
    content = finite_json(line)
    for name in COLUMNS:
        value = content.get(name)
        if name == "outcome":
            if value not in get_args(Outcome):
                raise ValueError(f"{name} is {value!r}")
        elif type(value) not in _TYPES[name]:  # type() and not isinstance(): a bool is not a number here
            raise ValueError(f"{name} is {value!r}")
    if content.get("keyframes") is not None and not _KEYFRAMES.fullmatch(str(content["keyframes"])):
        raise ValueError(f"keyframes is {content['keyframes']!r}")
    values: dict[str, Any] = {name: content[name] for name in COLUMNS if name in content}
    return TrialRow(**values)


def finite_json(line: str | bytes) -> dict[str, Json]:
    """Read a JSON object of finite numbers.

    Parameters
    ----------
    line : str or bytes

    Returns
    -------
    dict

    Raises
    ------
    ValueError
        If it is no JSON object, or a number in it is not finite or is an integer of more than 64 bits.
    """
    try:
        content = json.loads(line, parse_constant=_finite, parse_float=_finite, parse_int=_small)
    except RecursionError:
        raise ValueError("too deep") from None
    if not isinstance(content, dict):
        raise ValueError("not a JSON object")
    return content


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text} is not finite")
    return number


def _small(text: str) -> int:
    number = int(text)
    if abs(number) >= 1 << 63:
        raise ValueError("a number has more than 64 bits")
    return number


#: Absolute indices of frames, separated by spaces.
_KEYFRAMES = re.compile(r"\d{1,18}( \d{1,18})*")


def _types_by_column() -> dict[str, frozenset[type]]:
    """Return the types that JSON can give for each field. A whole number is a valid float."""
    hints = get_type_hints(TrialRow)
    types = {name: frozenset(get_args(hints[name]) or (hints[name],)) for name in COLUMNS if name != "outcome"}
    return {name: allowed | {int} if float in allowed else allowed for name, allowed in types.items()}


_TYPES = _types_by_column()
