"""The summary of a run: the content of ``summary.json``.

The JSON Schema of :class:`Summary` is ``summary.schema.json`` beside this file (:func:`summary_schema`). The recording
shows the same types (:mod:`slam_init.recording.text`), so that the file and the recording cannot disagree.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files

from slam_init.output.plain_json import Json, plain_fields
from slam_init.output.provenance import Provenance
from slam_init.output.records import (
    AttemptRecord,
    CameraRecord,
    ContinuationRecord,
    FocalLengthRecord,
    HypothesisRecord,
    KeyframeRecord,
    ScaleRecord,
    SegmentRecord,
    SourceRecord,
)
from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.frame import Source
from slam_init.types.reasons import Verdict
from slam_init.types.result import GroundTruthErrors, Result
from slam_init.types.stopwatch import StageTimes

#: Version of the layout. It is raised when a key of ``summary.json`` changes its name, its place or its meaning.
SCHEMA = 2

#: Name of the JSON Schema of the summary, beside this file.
SCHEMA_FILE = "summary.schema.json"


@dataclass(frozen=True)
class Summary:
    """The content of ``summary.json``. Two equal runs differ in ``timing_ms`` and ``provenance`` only.

    Attributes
    ----------
    schema : int
        Version of this layout.
    status : str
        ``initialized`` or ``not_initialized``.
    reason : Verdict or None
        Why there is no map; None when initialized.
    advice : str
        What the person who moves the camera should do; empty when initialized.
    source : SourceRecord
        The source of the frames.
    method : str
        Name of the method, e.g. ``quest``.
    seed : int
        Seed of all random draws.
    camera : CameraRecord
        The stated calibration.
    frames_read : int
        Number of frames that were read.
    frames_to_init : int or None
        Number of frames that were read when the map was accepted; None without a map.
    keyframes : tuple of KeyframeRecord
        The keyframes of the map; empty without a map.
    landmarks : int
        Number of landmarks; 0 without a map.
    median_parallax_deg : float or None
        Median over the landmarks of the largest angle between two rays of a landmark.
    depth_sigma : float or None
        Median over the landmarks of the relative standard deviation of the distance from the newest keyframe.
    reprojection_rmse_px : float or None
        Root mean square of the reprojection errors, in pixels.
    scene : str or None
        ``general`` or ``planar``.
    focal_length : FocalLengthRecord or None
        The focal length, if bundle adjustment adjusted it.
    scale : float or None
        Metres in a unit of the map of bundle adjustment, the median depth. Lengths of this summary and of all files are
        metres where it is given; None where no scale was found or looked for.
    scale_sigma : float or None
        Relative standard deviation of the scale.
    scale_origin : ScaleRecord or None
        Where the scale comes from, or why none was found; None if none was looked for.
    hypotheses : tuple of HypothesisRecord
        The two maps that the views could not decide between, the better one first; else empty.
    margin : Margin or None
        The last vote between two maps.
    attempts : tuple of AttemptRecord
        The last attempts.
    timing_ms : mapping of str to StageTimes
        Times by stage of the pipeline.
    ground_truth : GroundTruthErrors or None
        Errors of the keyframes, if there is ground truth.
    continued : ContinuationRecord or None
        The frames after the initialization, if the run continued.
    segments : tuple of SegmentRecord
        All maps of a run that starts anew after a loss, in time order; the keys above describe the first. Else empty.
    notes : tuple of str
        Notes for the user, e.g. that the calibration was guessed.
    provenance : Provenance or None
        The versions, options and input of the run.
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
    depth_sigma: float | None
    reprojection_rmse_px: float | None
    scene: str | None
    focal_length: FocalLengthRecord | None
    scale: float | None
    scale_sigma: float | None
    scale_origin: ScaleRecord | None
    hypotheses: tuple[HypothesisRecord, ...]
    margin: Margin | None
    attempts: tuple[AttemptRecord, ...]
    timing_ms: Mapping[str, StageTimes]
    ground_truth: GroundTruthErrors | None
    continued: ContinuationRecord | None
    segments: tuple[SegmentRecord, ...]
    notes: tuple[str, ...]
    provenance: Provenance | None

    def as_dict(self) -> dict[str, Json]:
        """Convert the summary to plain JSON types, as in the file."""
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
    segments: tuple[SegmentRecord, ...] = (),
    provenance: Provenance | None = None,
) -> Summary:
    """Summarize a run.

    * ``ground_truth``: From :func:`slam_init.evaluation.metrics.compare_with_groundtruth`.
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
        camera=CameraRecord.of(camera),
        frames_read=result.frames_read,
        frames_to_init=result.frames_to_init,
        keyframes=() if map_ is None else tuple(KeyframeRecord.of(keyframe) for keyframe in map_.keyframes),
        landmarks=0 if map_ is None else len(map_.points),
        median_parallax_deg=None if map_ is None else _known(map_.median_parallax_deg),
        depth_sigma=None if map_ is None else _known(map_.depth_sigma),
        reprojection_rmse_px=None if map_ is None else _known(map_.reprojection_rmse_px),
        scene=None if map_ is None else map_.scene,
        focal_length=None if map_ is None else FocalLengthRecord.of(map_),
        scale=None if result.scale is None else result.scale.metres_per_unit,
        scale_sigma=None if result.scale is None else result.scale.sigma,
        scale_origin=ScaleRecord.of(result.scale),
        # The hypotheses of an initialized run are the map itself, which the keys above describe.
        hypotheses=() if map_ is not None else tuple(HypothesisRecord.of(kept) for kept in result.hypotheses),
        margin=result.margin,
        attempts=tuple(AttemptRecord.of(attempt) for attempt in result.attempts),
        timing_ms=result.timing_ms,
        ground_truth=ground_truth,
        continued=continued,
        segments=segments,
        notes=result.notes,
        provenance=provenance,
    )


def _known(value: float) -> float | None:
    """The map of an external program has no landmarks, and figures of landmarks are NaN."""
    return value if math.isfinite(value) else None


def summary_text(summary: Summary) -> str:
    """Write the summary as indented JSON with a final newline. The text is ASCII, which any stream can encode."""
    return json.dumps(summary.as_dict(), indent=2, allow_nan=False) + "\n"


def summary_schema() -> dict[str, Json]:
    """Read the JSON Schema (draft 2020-12) of ``summary.json`` from the package.

    * Returns: For a validator such as ``jsonschema.validate(json.loads(text), summary_schema())``.
    """
    schema: dict[str, Json] = json.loads((files("slam_init.output") / SCHEMA_FILE).read_text(encoding="utf-8"))
    return schema
