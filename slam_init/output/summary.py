"""The summary of a run: the content of ``summary.json``.

The recording shows the same types (:mod:`slam_init.recording.text`), so that the file and the recording cannot
disagree. The page of all keys is made from :class:`Summary`. Its parts stand first: source, camera, keyframes,
attempts, continuation, segments, and the provenance of the result.
"""

from __future__ import annotations

import dataclasses
import hashlib
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from slam_init.output.plain_json import Json, plain_fields
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.evidence import FreeFocal, MapEvidence, Margin, PreviewEvidence, TwoViewEvidence, WindowEvidence
from slam_init.types.frame import Frame
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.refusal import Direction, GateName, Stage, Verdict
from slam_init.types.result import Attempt, GroundTruthErrors, Result, Segment
from slam_init.types.scale import Scale, ScaleOrigin
from slam_init.types.stopwatch import StageTimes

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


# -- the provenance of a result: versions, command line, options, a hash of the input --------------


@dataclass(frozen=True)
class Provenance:
    """The versions, options and input of a run."""

    #: Versions of Python and of the packages that a result depends on.
    packages: Mapping[str, str]
    #: The command line.
    command: tuple[str, ...]
    #: The resolved configuration and the options of the run.
    options: Mapping[str, Json]
    #: Hash of the calibration and of the frames that were read: pixels, names, time stamps and measured rotations, in
    #: order. Empty where another program read them.
    input_blake2b: str


#: The versions of these packages may change a result.
_PACKAGES = ("slam-init", "numpy", "scipy", "opencv-python-headless", "gtsam", "rerun-sdk", "numba")
NOT_INSTALLED = "not installed"


class InputHash:
    """Hash of the frames of a run. Equal pixels, masks, names, time stamps and calibrations have equal hashes.

    * ``camera``: The stated calibration.
    """

    def __init__(self, camera: Camera) -> None:
        self._hash = hashlib.blake2b(repr(camera).encode(), digest_size=16)

    def reading(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Pass frames through, and add them to the hash."""
        for frame in frames:
            header = f"{frame.index} {frame.timestamp_s!r} {frame.name} {frame.image.shape}"
            self._hash.update(header.encode("utf-8", "surrogateescape"))
            self._hash.update(np.ascontiguousarray(frame.image).data)
            if frame.mask is not None:
                self._hash.update(np.ascontiguousarray(frame.mask).data)
            if frame.gravity is not None:
                self._hash.update(np.append(frame.gravity.down, frame.gravity.sigma_deg).data)
            yield frame

    def add(self, *arrays: Floats | Ints) -> None:
        """Add what was measured besides the frames: given tracks, or the record of an inertial sensor."""
        for one in arrays:
            self._hash.update(np.ascontiguousarray(one).data)

    def turned(self, rotation: Floats, sigma_rad: float) -> None:
        """Add a measured rotation to the hash: ``rotation`` (3, 3)."""
        self.add(rotation)
        self._hash.update(repr(sigma_rad).encode())

    def hexdigest(self) -> str:
        """Return the hash of the frames that were read up to now."""
        return self._hash.hexdigest()


def provenance_of(command: Sequence[str], options: Mapping[str, Json], input_blake2b: str = "") -> Provenance:
    """Gather the provenance of a run, or of a result without the hash of its input."""
    return Provenance(package_versions(), tuple(command), options, input_blake2b)


def package_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that may change a result."""
    packages = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            packages[name] = NOT_INSTALLED
    return packages


# -- the summary -----------------------------------------------------------------------------------

#: Version of the layout. It is raised when a key of ``summary.json`` changes its name, its place or its meaning.
SCHEMA = 4


@dataclass(frozen=True)
class Summary:
    """The content of ``summary.json``. Two equal runs differ in ``timing_ms`` and ``provenance`` only."""

    #: Version of this layout.
    schema: int
    #: ``initialized`` or ``not_initialized``.
    status: str
    #: Why there is no map; None when initialized.
    reason: Verdict | None
    #: What the person who moves the camera should do; empty when initialized.
    advice: str
    #: The source of the frames.
    source: SourceRecord
    #: Name of the method, e.g. ``quest``.
    method: str
    #: Seed of all random draws.
    seed: int
    #: The stated calibration.
    camera: CameraRecord
    #: Number of frames that were read.
    frames_read: int
    #: Number of frames that were read when the map was accepted; None without a map.
    frames_to_init: int | None
    #: The keyframes of the map; empty without a map.
    keyframes: tuple[KeyframeRecord, ...]
    #: Number of landmarks; 0 without a map.
    landmarks: int
    #: Median over the landmarks of the largest angle between two rays of a landmark.
    median_parallax_deg: float | None
    #: Median over the landmarks of the relative standard deviation of the distance from the newest keyframe.
    depth_sigma: float | None
    #: Root mean square of the reprojection errors, in pixels.
    reprojection_rmse_px: float | None
    #: ``general`` or ``planar``.
    scene: str | None
    #: The focal length, if bundle adjustment adjusted it.
    focal_length: FocalLengthRecord | None
    #: The focal length by the tracks alone, where they contradict the stated one.
    wrong_focal: FreeFocal | None
    #: Metres in a unit of the map of bundle adjustment, the median depth. Lengths of this summary and of all files are
    #: metres where it is given; None where no scale was found or looked for.
    scale: float | None
    #: Relative standard deviation of the scale.
    scale_sigma: float | None
    #: Where the scale comes from, or why none was found; None if none was looked for.
    scale_origin: ScaleRecord | None
    #: In the world of the map; None where it was not measured.
    gravity: GravityRecord | None
    #: The two maps that the views could not decide between, the better one first; else empty.
    hypotheses: tuple[HypothesisRecord, ...]
    #: The last vote between two maps.
    margin: Margin | None
    #: The last attempts.
    attempts: tuple[AttemptRecord, ...]
    #: Times by stage of the pipeline.
    timing_ms: Mapping[str, StageTimes]
    #: Errors of the keyframes, if there is ground truth.
    ground_truth: GroundTruthErrors | None
    #: The frames after the initialization, if the run continued.
    continued: ContinuationRecord | None
    #: All maps of a run that restarts after a loss, in time order; the keys above describe the first. Else empty.
    segments: tuple[SegmentRecord, ...]
    #: Notes for the user, e.g. that the calibration was guessed.
    notes: tuple[str, ...]
    #: The versions, options and input of the run.
    provenance: Provenance | None

    def as_dict(self) -> dict[str, Json]:
        """Convert the summary to plain JSON types, as in the file."""
        return plain_fields(self)


#: The figures of a run without a map.
_NO_MAP = SimpleNamespace(median_parallax_deg=None, depth_sigma=None, reprojection_rmse_px=None, scene=None)


def summary_of(
    result: Result,
    source: SourceRecord,
    camera: Camera,
    *,
    ground_truth: GroundTruthErrors | None = None,
    continued: ContinuationRecord | None = None,
    segments: tuple[SegmentRecord, ...] = (),
    provenance: Provenance | None = None,
) -> Summary:
    """Summarize a run.

    * ``ground_truth``: From :func:`slam_init.evaluation.metrics.compare_with_groundtruth`.
    """
    map_ = result.map
    # The hypotheses of an initialized run are the map itself, which other keys describe.
    kept = () if map_ is not None else result.hypotheses
    return record(
        Summary,
        result,
        _NO_MAP if map_ is None else map_,
        schema=SCHEMA,
        source=source,
        camera=record(CameraRecord, camera),
        focal_length=None if map_ is None else FocalLengthRecord.describe(map_),
        hypotheses=tuple(record(HypothesisRecord, one, **map_figures(one, None)) for one in kept),
        attempts=tuple(AttemptRecord.describe(attempt) for attempt in result.attempts),
        ground_truth=ground_truth,
        continued=continued,
        segments=segments,
        provenance=provenance,
        **map_figures(map_, result.scale),
    )
