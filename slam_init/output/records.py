"""The parts of ``summary.json``: source, camera, keyframes, attempts, continuation, segments."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from slam_init.types.evidence import FreeFocal, MapEvidence, PreviewEvidence, TwoViewEvidence, WindowEvidence
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.refusal import Direction, GateName, Stage, Verdict
from slam_init.types.result import Attempt, GroundTruthErrors, Segment
from slam_init.types.scale import Scale, ScaleOrigin

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

#: Poses and intrinsics have three more significant digits than other floats, so that a trajectory can be rebuilt.
_EXACT = {"digits": 9}
#: Time stamps are written without rounding.
_AS_IS = {"digits": 17}


_Record = TypeVar("_Record", bound="DataclassInstance")


def record(kind: type[_Record], *things: object, **others: Any) -> _Record:
    """Make a record of others by name, and of attributes of things by the same names; further others are left out."""
    values = {}
    for name in (item.name for item in dataclasses.fields(kind)):
        values[name] = (
            others[name] if name in others else next(getattr(one, name) for one in things if hasattr(one, name))
        )
    return kind(**values)


@dataclass(frozen=True)
class SourceRecord:
    """The source of the frames."""

    #: Short name of the source.
    name: str
    #: ``tum``, ``euroc``, ``kitti``, ``images``, ``video``, ``ros1``, ``ros2``, ``synth`` or ``live``; a data set of
    #: the user has a word of its own.
    kind: str


@dataclass(frozen=True)
class CameraRecord:
    """The stated calibration."""

    #: Name of the lens model: ``pinhole``, ``radtan``, ``fisheye``, ``double-sphere`` (docs/how-to/camera.md).
    model: str
    #: width, height: Size of the images, in pixels.
    width: int
    height: int
    #: fx, fy, cx, cy: Intrinsics, in pixels.
    fx: float = field(metadata=_EXACT)
    fy: float = field(metadata=_EXACT)
    cx: float = field(metadata=_EXACT)
    cy: float = field(metadata=_EXACT)
    #: Coefficients of the model.
    distortion: tuple[float, ...] = field(metadata=_EXACT)
    #: Where the focal length is from: ``stated``, ``file``, ``metadata``, ``prior`` or ``estimated``.
    source: str
    #: Standard deviation of the focal length; null for a calibration.
    focal_sigma_px: float | None
    #: Time from the first to the last row of a rolling shutter; null where it is unknown.
    readout_ms: float | None = None
    #: ``down``, ``up``, ``right`` or ``left``.
    readout_direction: str = "down"


@dataclass(frozen=True)
class KeyframeRecord:
    """A keyframe of a map."""

    #: Absolute index of the frame.
    frame: int
    #: In seconds.
    timestamp: float = field(metadata=_AS_IS)
    #: Rotation of ``world_from_cam`` as a Hamilton quaternion, w first.
    q_wxyz: tuple[float, ...] = field(metadata=_EXACT)
    #: Translation of ``world_from_cam``, in units of the map.
    t: tuple[float, ...] = field(metadata=_EXACT)

    @staticmethod
    def describe(keyframe: Keyframe) -> KeyframeRecord:
        """Make the record of a keyframe."""
        q, t = keyframe.world_from_cam.q_wxyz, keyframe.world_from_cam.t
        return KeyframeRecord(int(keyframe.frame), float(keyframe.timestamp_s), tuple(q.tolist()), tuple(t.tolist()))


@dataclass(frozen=True)
class HypothesisRecord:
    """One of two maps that the views could not decide between."""

    #: In time order.
    keyframes: tuple[KeyframeRecord, ...]
    #: Number of landmarks.
    landmarks: int
    #: Root mean square of the reprojection errors, in pixels.
    reprojection_rmse_px: float


@dataclass(frozen=True)
class GateRecord:
    """A condition that was evaluated."""

    #: Name of the figure.
    name: GateName
    #: value, threshold: The figure and its bound, in the unit of the gate; None if the number is not finite.
    value: float | None
    threshold: float | None
    #: Whether the value passes from the threshold upwards or downwards.
    direction: Direction
    #: Unit of value and threshold; empty for shares, counts and ratios.
    unit: str
    #: Whether the gate passes.
    passes: bool
    #: The verdict if the gate does not pass.
    reason: Verdict
    #: What the person who moves the camera should do then.
    advice: str


@dataclass(frozen=True)
class AttemptRecord:
    """An attempt, without its matches."""

    #: Absolute indices of the pair (reference, current), then of the further keyframes of its map.
    frames: tuple[int, ...]
    #: ``accepted`` or the reason of the refusal.
    verdict: Verdict
    #: What the person who moves the camera should do; empty when accepted.
    advice: str
    #: The stage that refused the pair; None if it was accepted, or refused by the rules of another method.
    stage: Stage | None
    #: How far the pair advanced through the stages, 0 to 1.
    progress: float
    #: The conditions that were evaluated.
    gates: tuple[GateRecord, ...]
    #: Figures before any epipolar geometry.
    preview: PreviewEvidence | None
    #: Figures of the relative pose.
    two_view: TwoViewEvidence | None
    #: The focal length by the tracks alone, where they contradict the stated one.
    free_focal: FreeFocal | None
    #: Figures of the joint estimate of all views.
    window: WindowEvidence | None
    #: Figures of bundle adjustment.
    map: MapEvidence | None
    #: Figures of a third-party method, under its own names.
    method_evidence: Mapping[str, bool | float | int | str | None]

    @staticmethod
    def describe(attempt: Attempt) -> AttemptRecord:
        """Make the record of an attempt."""
        gates = tuple(record(GateRecord, gate, passes=gate.passes()) for gate in attempt.gates)
        return record(AttemptRecord, attempt, gates=gates)


@dataclass(frozen=True)
class FocalLengthRecord:
    """The focal length, if bundle adjustment adjusted it."""

    #: fx, fy: The adjusted focal length, in pixels.
    fx: float = field(metadata=_EXACT)
    fy: float = field(metadata=_EXACT)
    #: The adjusted focal length divided by the stated one.
    factor: float
    #: Standard deviation of the factor.
    factor_sigma: float

    @staticmethod
    def describe(map_: InitialMap) -> FocalLengthRecord | None:
        """Make the record of the focal length of a map."""
        if map_.focal_factor_sigma is None:
            return None
        return FocalLengthRecord(map_.camera.fx, map_.camera.fy, map_.focal_factor, map_.focal_factor_sigma)


@dataclass(frozen=True)
class ContinuationRecord:
    """The frames after the initialization."""

    #: Number of frames that were read.
    frames: int
    #: Number of frames that could be located in the map.
    located: int
    #: survival_median, survival_last: Share of the landmarks that a frame observes within 3 px of their projection:
    #: median over the frames, and the value of the last frame. None without frames.
    survival_median: float | None
    survival_last: float | None


@dataclass(frozen=True)
class ScaleRecord:
    """Where the scale of a map comes from, or why there is none."""

    #: What was known: ``marker``, ``board``, ``height``, ``distance``, ``groundtruth`` or ``imu``.
    origin: ScaleOrigin
    #: What the scale was found from, in words; empty where none was found.
    evidence: str
    #: Why no scale was found; empty where one was.
    reason: str


@dataclass(frozen=True)
class GravityRecord:
    """The direction of gravity."""

    #: Unit vector to the centre of the earth.
    down: tuple[float, float, float]
    #: Standard deviation of each of its two angles.
    sigma_deg: float


def map_figures(map_: InitialMap | None, scale: Scale | None) -> dict[str, Any]:
    """The fields of a run or a segment about its map, if there is one, and its scale, if one was looked for."""
    gravity = None if map_ is None else map_.gravity
    return {
        "keyframes": () if map_ is None else tuple(KeyframeRecord.describe(keyframe) for keyframe in map_.keyframes),
        "landmarks": 0 if map_ is None else len(map_.points),
        "scale": None if scale is None else scale.metres_per_unit,
        "scale_sigma": None if scale is None else scale.sigma,
        "scale_origin": None if scale is None else record(ScaleRecord, scale),
        "gravity": None if gravity is None else GravityRecord(tuple(gravity.down.tolist()), gravity.sigma_deg),
    }


@dataclass(frozen=True)
class SegmentRecord:
    """A map of a run that restarts after a loss."""

    #: Folder of its files.
    folder: str
    #: Absolute index of the first frame.
    first_frame: int
    #: Number of frames from there until the map was accepted.
    frames_to_init: int
    #: Absolute index of the frame at which the map was lost; None where the frames ended before.
    lost_at: int | None
    #: In the world frame of this map.
    keyframes: tuple[KeyframeRecord, ...]
    #: Number of landmarks.
    landmarks: int
    #: Median over the landmarks of the largest angle between two rays of a landmark.
    median_parallax_deg: float
    #: Root mean square of the reprojection errors, in pixels.
    reprojection_rmse_px: float
    #: Metres in a unit of the map of bundle adjustment; None where no scale was found.
    scale: float | None
    #: Relative standard deviation of the scale.
    scale_sigma: float | None
    #: Where the scale comes from; None if none was looked for.
    scale_origin: ScaleRecord | None
    #: In the world of this map; None where it was not measured.
    gravity: GravityRecord | None
    #: Errors of the keyframes, if there is ground truth.
    ground_truth: GroundTruthErrors | None
    #: The frames after the initialization.
    continued: ContinuationRecord

    @staticmethod
    def describe(
        folder: str, segment: Segment, continued: ContinuationRecord, ground_truth: GroundTruthErrors | None
    ) -> SegmentRecord:
        """Make the record of a segment."""
        figures = map_figures(segment.map, segment.scale)
        found = {"folder": folder, "ground_truth": ground_truth, "continued": continued}
        return record(SegmentRecord, segment, segment.map, **figures, **found)
