"""The summary of a run: the types of ``summary.json``, and the one serializer that writes them.

The JSON Schema of these types is ``summary.schema.json`` beside this file. The recording shows the same types
(:mod:`slam_init.recording.text`), so that the file and the recording cannot disagree.
"""

from __future__ import annotations

import dataclasses
import json
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TypeAlias

import numpy as np

from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.evidence import (
    FreeEvidence,
    MapEvidence,
    PreviewEvidence,
    RotationOnlyEvidence,
    TwoViewEvidence,
    VoteEvidence,
)
from slam_init.types.frame import Source
from slam_init.types.gates import Direction, Gate, GateName, Stage
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt, GroundTruthErrors, Result
from slam_init.types.stopwatch import StageTimes

__all__ = [
    "SCHEMA",
    "AttemptRecord",
    "CameraRecord",
    "ContinuationRecord",
    "FocalLengthRecord",
    "GateRecord",
    "HypothesisRecord",
    "Json",
    "KeyframeRecord",
    "Provenance",
    "SourceRecord",
    "Summary",
    "plain",
    "summary_of",
    "summary_text",
]

#: Raised where a key of ``summary.json`` changes its name, its place or its meaning.
SCHEMA = 2

#: What ``json`` writes and reads.
Json: TypeAlias = "None | bool | int | float | str | list[Json] | dict[str, Json]"

#: Significant digits of floats. Poses and intrinsics get three more, so that a trajectory can be rebuilt from them.
_DIGITS, _EXACT = 6, {"digits": 9}
#: Time stamps are written as they are.
_AS_IS = {"digits": 17}


@dataclass(frozen=True)
class SourceRecord:
    """Where the frames came from.

    Attributes
    ----------
    name : str
        Short name of the source.
    kind : str
        ``tum``, ``euroc``, ``kitti``, ``images``, ``video``, ``synth`` or ``python``.
    """

    name: str
    kind: str


@dataclass(frozen=True)
class CameraRecord:
    """The calibration that was stated.

    Attributes
    ----------
    model : str
        ``pinhole``, ``radtan`` or ``fisheye``.
    width, height : int
        Size of the images, in pixels.
    fx, fy, cx, cy : float
        Intrinsics, in pixels.
    distortion : tuple of float
        Coefficients of the model.
    guessed : bool
        Whether the focal length is a guess.
    """

    model: str
    width: int
    height: int
    fx: float = field(metadata=_EXACT)
    fy: float = field(metadata=_EXACT)
    cx: float = field(metadata=_EXACT)
    cy: float = field(metadata=_EXACT)
    distortion: tuple[float, ...] = field(metadata=_EXACT)
    guessed: bool


@dataclass(frozen=True)
class KeyframeRecord:
    """A keyframe.

    Attributes
    ----------
    frame : int
        Absolute index of the frame.
    timestamp : float
        In seconds.
    q_wxyz : tuple of four float
        Rotation of world_from_cam as a Hamilton quaternion, w first.
    t : tuple of three float
        Translation of world_from_cam, in units of the map.
    """

    frame: int
    timestamp: float = field(metadata=_AS_IS)
    q_wxyz: tuple[float, ...] = field(metadata=_EXACT)
    t: tuple[float, ...] = field(metadata=_EXACT)

    @staticmethod
    def of(keyframe: Keyframe) -> KeyframeRecord:
        """The record of a keyframe.

        Parameters
        ----------
        keyframe : Keyframe

        Returns
        -------
        KeyframeRecord
        """
        pose = keyframe.world_from_cam
        q, t = (tuple(map(float, values)) for values in (pose.q_wxyz, pose.t))
        return KeyframeRecord(int(keyframe.frame), float(keyframe.timestamp_s), q, t)


@dataclass(frozen=True)
class HypothesisRecord:
    """One of two maps that the views could not decide between.

    Attributes
    ----------
    keyframes : tuple of KeyframeRecord
        In time order.
    landmarks : int
        Their number.
    reprojection_rmse_px : float
        Root mean square of the reprojection errors, in pixels.
    """

    keyframes: tuple[KeyframeRecord, ...]
    landmarks: int
    reprojection_rmse_px: float


@dataclass(frozen=True)
class GateRecord:
    """A condition that was looked at.

    Attributes
    ----------
    name : GateName
        Name of the figure.
    value, threshold : float or None
        In the unit of the gate; None where the figure is not finite.
    direction : Direction
        Whether the value passes from the threshold upwards or downwards.
    unit : str
        Unit of value and threshold; empty for shares, counts and ratios.
    passes : bool
        Whether the gate passes.
    reason : Verdict
        The verdict where it does not pass.
    advice : str
        What would help then.
    """

    name: GateName
    value: float | None
    threshold: float | None
    direction: Direction
    unit: str
    passes: bool
    reason: Verdict
    advice: str

    @staticmethod
    def of(gate: Gate) -> GateRecord:
        """The record of a gate.

        Parameters
        ----------
        gate : Gate

        Returns
        -------
        GateRecord
        """
        return GateRecord(
            gate.name,
            gate.value,
            gate.threshold,
            gate.direction,
            gate.unit,
            gate.passes(),
            gate.reason,
            gate.advice,
        )


@dataclass(frozen=True)
class AttemptRecord:
    """An attempt, without its matches.

    Attributes
    ----------
    frames : tuple of int
        The pair (reference, current), then further views that voted.
    verdict : Verdict
        ``accepted`` or the reason of the refusal.
    advice : str
        What would help; empty when accepted.
    stage : Stage or None
        The stage that refused the pair; None where it was accepted, or refused by the rules of another method.
    progress : float
        How far the pair came, 0 to 1.
    parallax_shortfall : float
        Required baseline divided by the current one, from the worst gate that scales with parallax; 1 if none does.
    gates : tuple of GateRecord
        The conditions that were looked at.
    preview : PreviewEvidence or None
        Before any epipolar geometry.
    two_view : TwoViewEvidence or None
        Of the relative pose.
    rotation_only : RotationOnlyEvidence or None
        Of the rival explanation by a camera that only rotates.
    vote : VoteEvidence or None
        Of the vote between rival maps.
    map : MapEvidence or None
        Of bundle adjustment.
    method_evidence : mapping of str to float, int or str
        What a method of somebody else told.
    """

    frames: tuple[int, ...]
    verdict: Verdict
    advice: str
    stage: Stage | None
    progress: float
    parallax_shortfall: float
    gates: tuple[GateRecord, ...]
    preview: PreviewEvidence | None
    two_view: TwoViewEvidence | None
    rotation_only: RotationOnlyEvidence | None
    vote: VoteEvidence | None
    map: MapEvidence | None
    method_evidence: FreeEvidence

    @staticmethod
    def of(attempt: Attempt) -> AttemptRecord:
        """The record of an attempt.

        Parameters
        ----------
        attempt : Attempt

        Returns
        -------
        AttemptRecord
        """
        shared = {item.name: getattr(attempt, item.name) for item in dataclasses.fields(AttemptRecord)}
        return AttemptRecord(**shared | {"gates": tuple(GateRecord.of(gate) for gate in attempt.gates)})


@dataclass(frozen=True)
class FocalLengthRecord:
    """The focal length, where bundle adjustment adjusted it.

    Attributes
    ----------
    fx, fy : float
        Adjusted, in pixels.
    factor : float
        The adjusted focal length over the stated one.
    factor_sigma : float
        Standard deviation of the factor.
    """

    fx: float = field(metadata=_EXACT)
    fy: float = field(metadata=_EXACT)
    factor: float
    factor_sigma: float


@dataclass(frozen=True)
class ContinuationRecord:
    """The frames after the initialization.

    Attributes
    ----------
    frames : int
        Number of frames that were looked at.
    located : int
        Number of frames that could be located in the map.
    survival_median, survival_last : float or None
        Share of the landmarks that a frame sees within 3 px: median over the frames, and of the last frame.
    """

    frames: int
    located: int
    survival_median: float | None
    survival_last: float | None


@dataclass(frozen=True)
class Provenance:
    """What a result was made with and from.

    Attributes
    ----------
    packages : mapping of str to str
        Versions of the packages that matter, and of Python.
    command : tuple of str
        The command line.
    options : mapping of str to JSON
        The resolved configuration and the options of the run.
    input_blake2b : str
        Hash of the calibration and of the frames that were read: pixels, names and time stamps, in order.
    """

    packages: Mapping[str, str]
    command: tuple[str, ...]
    options: Mapping[str, Json]
    input_blake2b: str


@dataclass(frozen=True)
class Summary:
    """The content of ``summary.json``, the same for the same run except ``timing_ms`` and ``provenance``.

    Attributes
    ----------
    schema : int
        Version of this layout.
    status : str
        ``initialized`` or ``not_initialized``.
    reason : Verdict or None
        Why there is no map; None when initialized.
    advice : str
        What would help; empty when initialized.
    source : SourceRecord
        Where the frames came from.
    method : str
        Name of the method, e.g. ``quest``.
    seed : int
        Seed of all random draws.
    camera : CameraRecord
        The calibration that was stated.
    frames_read : int
        Number of frames that were read.
    frames_to_init : int or None
        Number of frames, counted from the first one read, when the map was accepted.
    keyframes : tuple of KeyframeRecord
        Of the map; empty without one.
    landmarks : int
        Their number; 0 without a map.
    median_parallax_deg : float or None
        Median over landmarks of the largest angle between two of its rays.
    reprojection_rmse_px : float or None
        Root mean square of the reprojection errors.
    scene : str or None
        ``general`` or ``planar``.
    focal_length : FocalLengthRecord or None
        Where bundle adjustment adjusted it.
    hypotheses : tuple of HypothesisRecord
        The two maps that the views could not decide between, the better one first; else empty.
    margin : Margin or None
        The last vote between two maps.
    attempts : tuple of AttemptRecord
        The last attempts.
    timing_ms : mapping of str to StageTimes
        Times by stage of the pipeline.
    ground_truth : GroundTruthErrors or None
        Errors of the keyframes, where there is ground truth.
    continued : ContinuationRecord or None
        The frames after the initialization, where they were asked for.
    notes : tuple of str
        What the user should know.
    provenance : Provenance or None
        What the result was made with and from.
    """

    schema: int
    status: str
    reason: Verdict | None
    advice: str
    source: SourceRecord
    method: str
    seed: int
    camera: CameraRecord
    frames_read: int
    frames_to_init: int | None
    keyframes: tuple[KeyframeRecord, ...]
    landmarks: int
    median_parallax_deg: float | None
    reprojection_rmse_px: float | None
    scene: str | None
    focal_length: FocalLengthRecord | None
    hypotheses: tuple[HypothesisRecord, ...]
    margin: Margin | None
    attempts: tuple[AttemptRecord, ...]
    timing_ms: Mapping[str, StageTimes]
    ground_truth: GroundTruthErrors | None
    continued: ContinuationRecord | None
    notes: tuple[str, ...]
    provenance: Provenance | None

    def as_dict(self) -> dict[str, Json]:
        """Plain JSON types, as in the file.

        Returns
        -------
        dict
        """
        return plain_fields(self)

    def __getitem__(self, key: str) -> Json:
        warnings.warn(
            f'summary["{key}"] is deprecated: use summary.{key}, or summary.as_dict()', DeprecationWarning, stacklevel=2
        )
        return self.as_dict()[key]


def summary_of(
    result: Result,
    source: Source,
    camera: Camera,
    method: str,
    seed: int,
    *,
    ground_truth: GroundTruthErrors | None = None,
    continued: ContinuationRecord | None = None,
    provenance: Provenance | None = None,
) -> Summary:
    """Summarize a run.

    Parameters
    ----------
    result : Result
    source : Source
    camera : Camera
        The calibration that was stated.
    method : str
        Name of the method.
    seed : int
    ground_truth : GroundTruthErrors, optional
        Of :func:`slam_init.evaluation.metrics.compare_with_groundtruth`.
    continued : ContinuationRecord, optional
        Of the frames after the initialization.
    provenance : Provenance, optional
        Of :func:`slam_init.output.provenance.provenance_of`.

    Returns
    -------
    Summary
    """
    map_ = result.map
    return Summary(
        schema=SCHEMA,
        status=result.status,
        reason=result.reason,
        advice=result.advice,
        source=SourceRecord(source.name, source.kind),
        method=method,
        seed=int(seed),
        camera=CameraRecord(
            camera.model,
            camera.width,
            camera.height,
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            tuple(camera.distortion),
            camera.guessed,
        ),
        frames_read=result.frames_read,
        frames_to_init=result.frames_to_init,
        keyframes=() if map_ is None else tuple(KeyframeRecord.of(keyframe) for keyframe in map_.keyframes),
        landmarks=0 if map_ is None else len(map_.points),
        median_parallax_deg=None if map_ is None else map_.median_parallax_deg,
        reprojection_rmse_px=None if map_ is None else map_.reprojection_rmse_px,
        scene=None if map_ is None else map_.scene,
        focal_length=_focal_length(map_),
        # The accepted map is no hypothesis any more.
        hypotheses=() if map_ is not None else tuple(_hypothesis(kept) for kept in result.hypotheses),
        margin=result.margin,
        attempts=tuple(AttemptRecord.of(attempt) for attempt in result.attempts),
        timing_ms=result.timing_ms,
        ground_truth=ground_truth,
        continued=continued,
        notes=result.notes,
        provenance=provenance,
    )


def summary_text(summary: Summary) -> str:
    """The summary as JSON in ASCII, which any stream takes, indented, with a final newline.

    Parameters
    ----------
    summary : Summary

    Returns
    -------
    str
    """
    return json.dumps(summary.as_dict(), indent=2, allow_nan=False) + "\n"


def plain(value: object, digits: int = _DIGITS) -> Json:
    """Plain JSON types of a value.

    Parameters
    ----------
    value : object
        Dataclasses become objects, sequences and arrays become lists, enumerations become their value, and floats that
        are not finite become None.
    digits : int
        Significant digits of floats. A field of a dataclass may have its own number in its metadata.

    Returns
    -------
    None, bool, int, float, str, list or dict
    """
    if isinstance(value, Enum):
        return plain(value.value, digits)
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain_fields(value, digits)
    if isinstance(value, Mapping):
        return {str(key): plain(item, digits) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(item, digits) for item in value]
    return str(value)


def plain_fields(value: object, digits: int = _DIGITS) -> dict[str, Json]:
    """The fields of a dataclass by name, in plain JSON types.

    Parameters
    ----------
    value : dataclass
    digits : int
        Significant digits of floats.

    Returns
    -------
    dict
    """
    if not dataclasses.is_dataclass(value):
        raise TypeError(f"{type(value).__name__} is no dataclass")
    return {
        item.name: plain(getattr(value, item.name), item.metadata.get("digits", digits))
        for item in dataclasses.fields(value)
    }


def _focal_length(map_: InitialMap | None) -> FocalLengthRecord | None:
    if map_ is None or map_.focal_factor_sigma is None:
        return None
    return FocalLengthRecord(map_.camera.fx, map_.camera.fy, map_.focal_factor, map_.focal_factor_sigma)


def _hypothesis(map_: InitialMap) -> HypothesisRecord:
    return HypothesisRecord(
        tuple(KeyframeRecord.of(keyframe) for keyframe in map_.keyframes), len(map_.points), map_.reprojection_rmse_px
    )
