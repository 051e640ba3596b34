"""The summary of a run: the content of ``summary.json``.

The recording shows the same types (:mod:`slam_init.recording.text`), so that the file and the recording cannot
disagree. The page of all keys is made from :class:`Summary`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from slam_init.output.plain_json import Json, plain_fields
from slam_init.output.provenance import Provenance
from slam_init.output.records import (
    AttemptRecord,
    CameraRecord,
    ContinuationRecord,
    FocalLengthRecord,
    GravityRecord,
    HypothesisRecord,
    KeyframeRecord,
    ScaleRecord,
    SegmentRecord,
    SourceRecord,
    map_figures,
    record,
)
from slam_init.types.camera import Camera
from slam_init.types.evidence import FreeFocal, Margin
from slam_init.types.refusal import Verdict
from slam_init.types.result import GroundTruthErrors, Result
from slam_init.types.stopwatch import StageTimes

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
        schema=SCHEMA,
        source=source,
        camera=record(CameraRecord, camera),
        median_parallax_deg=None if map_ is None else _known(map_.median_parallax_deg),
        depth_sigma=None if map_ is None else _known(map_.depth_sigma),
        reprojection_rmse_px=None if map_ is None else _known(map_.reprojection_rmse_px),
        scene=None if map_ is None else map_.scene,
        focal_length=None if map_ is None else FocalLengthRecord.describe(map_),
        hypotheses=tuple(record(HypothesisRecord, one, **map_figures(one, None)) for one in kept),
        attempts=tuple(AttemptRecord.describe(attempt) for attempt in result.attempts),
        ground_truth=ground_truth,
        continued=continued,
        segments=segments,
        provenance=provenance,
        **map_figures(map_, result.scale),
    )


def _known(value: float) -> float | None:
    """The map of an external program has no landmarks, and figures of landmarks are NaN."""
    return value if math.isfinite(value) else None
