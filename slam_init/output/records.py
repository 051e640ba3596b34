"""The parts of ``summary.json``: source, camera, keyframes, attempts, continuation, segments."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

from slam_init.types.camera import Camera
from slam_init.types.evidence import (
    MapEvidence,
    PreviewEvidence,
    RotationOnlyEvidence,
    TwoViewEvidence,
    WindowEvidence,
)
from slam_init.types.gates import Direction, Gate, GateName, Stage
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt, GroundTruthErrors, Segment
from slam_init.types.scale import Scale, ScaleOrigin

#: Poses and intrinsics have three more significant digits than other floats, so that a trajectory can be rebuilt.
_EXACT = {"digits": 9}
#: Time stamps are written without rounding.
_AS_IS = {"digits": 17}


@dataclass(frozen=True)
class SourceRecord:
    """The source of the frames.

    Attributes
    ----------
    name : str
        Short name of the source.
    kind : str
        ``tum``, ``euroc``, ``kitti``, ``images``, ``video``, ``ros1``, ``ros2``, ``synth`` or ``live``; a data set of
        the user has a word of its own.
    """

    name: str
    kind: str


@dataclass(frozen=True)
class CameraRecord:
    """The stated calibration.

    Attributes
    ----------
    model : str
        Name of the lens model: ``pinhole``, ``radtan``, ``fisheye``, ``double-sphere`` and so on (docs/lenses.md).
    width, height : int
        Size of the images, in pixels.
    fx, fy, cx, cy : float
        Intrinsics, in pixels.
    distortion : tuple of float
        Coefficients of the model.
    source : str
        Where the focal length is from: ``stated``, ``file``, ``metadata``, ``prior`` or ``estimated``.
    focal_sigma_px : float or None
        Standard deviation of the focal length; null for a calibration.
    readout_ms : float or None
        Time from the first to the last row of a rolling shutter; null where it is unknown.
    readout_direction : str
        ``down``, ``up``, ``right`` or ``left``.
    """

    model: str
    width: int
    height: int
    fx: float = field(metadata=_EXACT)
    fy: float = field(metadata=_EXACT)
    cx: float = field(metadata=_EXACT)
    cy: float = field(metadata=_EXACT)
    distortion: tuple[float, ...] = field(metadata=_EXACT)
    source: str
    focal_sigma_px: float | None
    readout_ms: float | None = None
    readout_direction: str = "down"

    @staticmethod
    def of(camera: Camera) -> CameraRecord:
        """Make the record of a camera."""
        return CameraRecord(
            camera.model,
            camera.width,
            camera.height,
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            tuple(camera.distortion),
            camera.source,
            camera.focal_sigma_px,
            camera.readout_ms,
            camera.readout_direction,
        )


@dataclass(frozen=True)
class KeyframeRecord:
    """A keyframe of a map.

    Attributes
    ----------
    frame : int
        Absolute index of the frame.
    timestamp : float
        In seconds.
    q_wxyz : tuple of four float
        Rotation of ``world_from_cam`` as a Hamilton quaternion, w first.
    t : tuple of three float
        Translation of ``world_from_cam``, in units of the map.
    """

    frame: int
    timestamp: float = field(metadata=_AS_IS)
    q_wxyz: tuple[float, ...] = field(metadata=_EXACT)
    t: tuple[float, ...] = field(metadata=_EXACT)

    @staticmethod
    def of(keyframe: Keyframe) -> KeyframeRecord:
        """Make the record of a keyframe."""
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
        Number of landmarks.
    reprojection_rmse_px : float
        Root mean square of the reprojection errors, in pixels.
    """

    keyframes: tuple[KeyframeRecord, ...]
    landmarks: int
    reprojection_rmse_px: float

    @staticmethod
    def of(map_: InitialMap) -> HypothesisRecord:
        """Make the record of an undecided map."""
        keyframes = tuple(KeyframeRecord.of(keyframe) for keyframe in map_.keyframes)
        return HypothesisRecord(keyframes, len(map_.points), map_.reprojection_rmse_px)


@dataclass(frozen=True)
class GateRecord:
    """A condition that was evaluated.

    Attributes
    ----------
    name : GateName
        Name of the figure.
    value, threshold : float or None
        The figure and its bound, in the unit of the gate; None if the number is not finite.
    direction : Direction
        Whether the value passes from the threshold upwards or downwards.
    unit : str
        Unit of value and threshold; empty for shares, counts and ratios.
    passes : bool
        Whether the gate passes.
    reason : Verdict
        The verdict if the gate does not pass.
    advice : str
        What the person who moves the camera should do then.
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
        """Make the record of a gate."""
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
        Absolute indices of the pair (reference, current), then of the further keyframes of its map.
    verdict : Verdict
        ``accepted`` or the reason of the refusal.
    advice : str
        What the person who moves the camera should do; empty when accepted.
    stage : Stage or None
        The stage that refused the pair; None if it was accepted, or refused by the rules of another method.
    progress : float
        How far the pair advanced through the stages, 0 to 1.
    gates : tuple of GateRecord
        The conditions that were evaluated.
    preview : PreviewEvidence or None
        Figures before any epipolar geometry.
    two_view : TwoViewEvidence or None
        Figures of the relative pose.
    rotation_only : RotationOnlyEvidence or None
        Figures of the explanation by a rotation-only camera.
    window : WindowEvidence or None
        Figures of the joint estimate of all views.
    map : MapEvidence or None
        Figures of bundle adjustment.
    method_evidence : mapping of str to bool, float, int, str or None
        Figures of a method of somebody else, under its own names.
    """

    frames: tuple[int, ...]
    verdict: Verdict
    advice: str
    stage: Stage | None
    progress: float
    gates: tuple[GateRecord, ...]
    preview: PreviewEvidence | None
    two_view: TwoViewEvidence | None
    rotation_only: RotationOnlyEvidence | None
    window: WindowEvidence | None
    map: MapEvidence | None
    method_evidence: Mapping[str, bool | float | int | str | None]

    @staticmethod
    def of(attempt: Attempt) -> AttemptRecord:
        """Make the record of an attempt."""
        shared = {item.name: getattr(attempt, item.name) for item in dataclasses.fields(AttemptRecord)}
        return AttemptRecord(**shared | {"gates": tuple(GateRecord.of(gate) for gate in attempt.gates)})


@dataclass(frozen=True)
class FocalLengthRecord:
    """The focal length, if bundle adjustment adjusted it.

    Attributes
    ----------
    fx, fy : float
        The adjusted focal length, in pixels.
    factor : float
        The adjusted focal length divided by the stated one.
    factor_sigma : float
        Standard deviation of the factor.
    """

    fx: float = field(metadata=_EXACT)
    fy: float = field(metadata=_EXACT)
    factor: float
    factor_sigma: float

    @staticmethod
    def of(map_: InitialMap) -> FocalLengthRecord | None:
        """Make the record of the focal length of a map."""
        if map_.focal_factor_sigma is None:
            return None
        return FocalLengthRecord(map_.camera.fx, map_.camera.fy, map_.focal_factor, map_.focal_factor_sigma)


@dataclass(frozen=True)
class ContinuationRecord:
    """The frames after the initialization.

    Attributes
    ----------
    frames : int
        Number of frames that were read.
    located : int
        Number of frames that could be located in the map.
    survival_median, survival_last : float or None
        Share of the landmarks that a frame observes within 3 px of their projection: median over the frames, and the
        value of the last frame. None without frames.
    """

    frames: int
    located: int
    survival_median: float | None
    survival_last: float | None


@dataclass(frozen=True)
class ScaleRecord:
    """Where the scale of a map comes from, or why there is none.

    Attributes
    ----------
    origin : ScaleOrigin
        What was known: ``marker``, ``board``, ``height``, ``distance`` or ``groundtruth``.
    evidence : str
        What the scale was found from, in words; empty where none was found.
    reason : str
        Why no scale was found; empty where one was.
    """

    origin: ScaleOrigin
    evidence: str
    reason: str

    @staticmethod
    def of(scale: Scale | None) -> ScaleRecord | None:
        """Make the record of a scale."""
        return None if scale is None else ScaleRecord(scale.origin, scale.evidence, scale.reason)


@dataclass(frozen=True)
class SegmentRecord:
    """A map of a run that starts anew after a loss.

    Attributes
    ----------
    folder : str
        Folder of its files.
    first_frame : int
        Absolute index of the first frame.
    frames_to_init : int
        Number of frames from there until the map was accepted.
    lost_at : int or None
        Absolute index of the frame at which the map was lost; None where the frames ended before.
    keyframes : tuple of KeyframeRecord
        In the world frame of this map.
    landmarks : int
        Number of landmarks.
    median_parallax_deg : float
        Median over the landmarks of the largest angle between two rays of a landmark.
    reprojection_rmse_px : float
        Root mean square of the reprojection errors, in pixels.
    scale : float or None
        Metres in a unit of the map of bundle adjustment; None where no scale was found.
    scale_sigma : float or None
        Relative standard deviation of the scale.
    scale_origin : ScaleRecord or None
        Where the scale comes from; None if none was looked for.
    ground_truth : GroundTruthErrors or None
        Errors of the keyframes, if there is ground truth.
    continued : ContinuationRecord
        The frames after the initialization.
    """

    folder: str
    first_frame: int
    frames_to_init: int
    lost_at: int | None
    keyframes: tuple[KeyframeRecord, ...]
    landmarks: int
    median_parallax_deg: float
    reprojection_rmse_px: float
    scale: float | None
    scale_sigma: float | None
    scale_origin: ScaleRecord | None
    ground_truth: GroundTruthErrors | None
    continued: ContinuationRecord

    @staticmethod
    def of(
        folder: str, segment: Segment, continued: ContinuationRecord, ground_truth: GroundTruthErrors | None
    ) -> SegmentRecord:
        """Make the record of a segment."""
        map_, scale = segment.map, segment.scale
        return SegmentRecord(
            folder=folder,
            first_frame=segment.first_frame,
            frames_to_init=segment.frames_to_init,
            lost_at=segment.lost_at,
            keyframes=tuple(KeyframeRecord.of(keyframe) for keyframe in map_.keyframes),
            landmarks=len(map_.points),
            median_parallax_deg=map_.median_parallax_deg,
            reprojection_rmse_px=map_.reprojection_rmse_px,
            scale=None if scale is None else scale.metres_per_unit,
            scale_sigma=None if scale is None else scale.sigma,
            scale_origin=ScaleRecord.of(scale),
            ground_truth=ground_truth,
            continued=continued,
        )
