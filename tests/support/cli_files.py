"""Summaries and files for tests of the command line."""

from dataclasses import replace

from make_map import make_result

from slam_init.output.summary import SCHEMA, AttemptRecord, CameraRecord, KeyframeRecord, SourceRecord, Summary
from slam_init.types.refusal import Verdict
from slam_init.types.result import Attempt, GroundTruthErrors

IMAGES = "my images é"
WITH = ["--camera", "good.yaml"]
#: Stands in for the result of a pipeline that is not run.
NO_MAP = make_result(None, Verdict.STATIC_CAMERA)
CAMERA = "model: pinhole\nwidth: 64\nheight: 48\nfx: 60\nfy: 60\ncx: 31.5\ncy: 23.5\n"


def attempts(*verdicts):
    return tuple(AttemptRecord.describe(Attempt((0, k + 1), Verdict(verdict))) for k, verdict in enumerate(verdicts))


INITIALIZED = Summary(
    schema=SCHEMA,
    status="initialized",
    reason=None,
    advice="",
    source=SourceRecord("images", "images"),
    method="quest",
    seed=0,
    camera=CameraRecord("pinhole", 64, 48, 60.0, 60.0, 31.5, 23.5, (), "file", None),
    frames_read=23,
    frames_to_init=23,
    keyframes=(KeyframeRecord(0, 0.0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),),
    landmarks=431,
    median_parallax_deg=3.21,
    depth_sigma=0.042,
    reprojection_rmse_px=0.314,
    scene="general",
    focal_length=None,
    wrong_focal=None,
    scale=None,
    scale_sigma=None,
    scale_origin=None,
    gravity=None,
    hypotheses=(),
    margin=None,
    attempts=attempts("low_parallax", "accepted"),
    timing_ms={},
    ground_truth=GroundTruthErrors(0.12, 0.8, None, 1.0),
    continued=None,
    segments=(),
    notes=(),
    provenance=None,
)
REFUSED = replace(
    INITIALIZED,
    status="not_initialized",
    reason=Verdict.STATIC_CAMERA,
    advice="the camera stands still: move it sideways",
    frames_to_init=None,
    keyframes=(),
    landmarks=0,
    attempts=attempts(*4 * ["static_camera"]),
    ground_truth=None,
)
