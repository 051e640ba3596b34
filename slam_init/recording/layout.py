"""The layout of a recording in the viewer, and the figures that it plots."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from slam_init.types.gates import GateName
from slam_init.types.result import Attempt

__all__ = [
    "ARROWS",
    "ARROW_FACTOR",
    "BUDGET_MS",
    "ERROR",
    "ERROR_BARS",
    "ESTIMATE_COLOR",
    "FRAME_BUDGET",
    "FRAME_TIME",
    "PURPLE",
    "SERIES",
    "TRACKS",
    "TRUTH_COLOR",
    "Color",
    "Series",
    "blueprint",
    "name_parts",
]

Color = tuple[int, int, int]

ESTIMATE_COLOR: Color = (60, 160, 255)
TRUTH_COLOR: Color = (255, 150, 40)
_GREEN: Color = (60, 200, 90)
PURPLE: Color = (190, 120, 230)
_GATE_COLOR: Color = (230, 70, 70)

TRACKS = "stats/counts/tracks"
ERROR = "stats/bundle/error"
ERROR_BARS = "stats/bundle/error_bars"
FRAME_TIME = "stats/time/frame"
FRAME_BUDGET = "stats/time/budget"
#: Time between two frames of a camera at 30 Hz.
BUDGET_MS = 1000 / 30


@dataclass(frozen=True)
class Series:
    """A plotted figure.

    Attributes
    ----------
    entity : str
        Path of the entity; its last but one part names the plot.
    label : str
        Name in the legend.
    color : (int, int, int)
        RGB, 0 to 255.
    of_attempt : function of Attempt, or None
        Returns the figure of an attempt, or None if the attempt does not have it. None if the figure does not come from
        an attempt.
    """

    entity: str
    label: str
    color: Color
    of_attempt: Callable[[Attempt], float | None] | None = None


def _gate_value(name: GateName) -> Callable[[Attempt], float | None]:
    """Return a function that returns the value of a gate of an attempt."""
    return lambda attempt: next((gate.value for gate in attempt.gates if gate.name is name), None)


def _gate_threshold(name: GateName) -> Callable[[Attempt], float | None]:
    """Return a function that returns the threshold of a gate of an attempt."""
    return lambda attempt: next((gate.threshold for gate in attempt.gates if gate.name is name), None)


def _parallax_px(attempt: Attempt) -> float | None:
    return None if attempt.preview is None else attempt.preview.parallax_px


def _parallax_share(attempt: Attempt) -> float | None:
    return None if attempt.preview is None else attempt.preview.parallax_share


def _readout_ms(attempt: Attempt) -> float | None:
    return None if attempt.window is None else attempt.window.readout_ms


def _direction_sigma_deg(attempt: Attempt) -> float | None:
    return None if attempt.window is None else attempt.window.direction_sigma_deg


#: The arrows of a rolling shutter are drawn this many times as long: they are some pixels.
ARROWS, ARROW_FACTOR = "world/camera/image/readout", 4
#: The figures that show the progress of an initialization. First the parallax grows. Then the standard deviation of the
#: direction falls, and the risk falls below its gate. The panel of the verdict lists all other figures.
SERIES = (
    Series(TRACKS, "tracks", ESTIMATE_COLOR),
    Series("stats/counts/landmarks", "landmarks", _GREEN, _gate_value(GateName.LANDMARKS)),
    Series("stats/parallax/median", "median", ESTIMATE_COLOR, _parallax_px),
    Series("stats/shares/parallax", "with parallax", ESTIMATE_COLOR, _parallax_share),
    Series("stats/direction/sigma", "standard deviation", ESTIMATE_COLOR, _direction_sigma_deg),
    Series("stats/readout/estimate", "rolling shutter", ESTIMATE_COLOR, _readout_ms),
    Series("stats/risk/total", "risk", PURPLE, _gate_value(GateName.RISK)),
    Series("stats/risk/gate", "gate", _GATE_COLOR, _gate_threshold(GateName.RISK)),
    Series(ERROR, "rms residual", ESTIMATE_COLOR),
    Series(FRAME_TIME, "frame", ESTIMATE_COLOR),
    Series(FRAME_BUDGET, "30 Hz", _GATE_COLOR),
)


def blueprint() -> Any:
    """Make the layout: the map and the keyframes at the left; image, pair, series and verdict at the right.

    Returns
    -------
    rerun.blueprint.Blueprint
    """
    import rerun.blueprint as rrb

    space, keyframes = _space_views()
    camera = rrb.Spatial2DView(
        origin="world/camera/image", name=f"frame and tracks; purple: turned back by the shutter, x {ARROW_FACTOR}"
    )
    pair = rrb.Spatial2DView(origin="pairs/image", name="pair tried: inliers green, outliers red, moving bodies purple")
    verdict = rrb.TextDocumentView(origin="pairs/verdict", name="verdict")
    parallax, shares, direction, risk, readout, times, counts = (
        rrb.TimeSeriesView(origin=f"stats/{plot}", name=name, plot_legend=corner)
        for plot, name, corner in (
            ("parallax", "parallax (px)", rrb.Corner2D.LeftTop),
            ("shares", "shares of matches", rrb.Corner2D.LeftTop),
            ("direction", "direction (deg)", rrb.Corner2D.RightTop),
            ("risk", "risk", rrb.Corner2D.RightTop),
            ("readout", "readout (ms)", rrb.Corner2D.RightTop),
            ("time", "time (ms)", rrb.Corner2D.RightTop),
            ("counts", "counts", rrb.Corner2D.LeftBottom),
        )
    )
    bundle = rrb.BarChartView(origin=ERROR_BARS, name="BA rms (px)", plot_legend=rrb.PlotLegend(visible=False))
    iterations = rrb.TimeSeriesView(origin=ERROR, name="BA rms (px), timeline ba_iter")
    log = rrb.TextLogView(
        origin="log",
        name="log",
        columns=rrb.TextLogColumns(timeline_columns=["frame"], text_log_columns=["Body"]),
    )
    summary = rrb.TextDocumentView(origin="summary", name="summary")
    root = rrb.Horizontal(
        rrb.Vertical(
            space,
            rrb.Horizontal(keyframes, rrb.Tabs(log, summary, iterations, name="text"), column_shares=[1, 1]),
            row_shares=[5, 3],
        ),
        rrb.Vertical(
            rrb.Horizontal(camera, verdict, column_shares=[3, 2]),
            pair,
            rrb.Horizontal(
                rrb.Tabs(parallax, shares), rrb.Tabs(risk, direction, readout), rrb.Tabs(counts, times), bundle
            ),
            row_shares=[3, 3, 2],
        ),
        column_shares=[1, 1],
    )
    name_parts(root, "slam-init")
    return rrb.Blueprint(root, rrb.TimePanel(timeline="frame", state="collapsed"), collapse_panels=True)


def _space_views() -> tuple[Any, Any]:
    """Make the view of the map from behind the first camera, and the view of the path and the keyframes."""
    import rerun as rr
    import rerun.blueprint as rrb

    no_axes = [rr.TransformAxes3D(0.0)]  # the frusta show the directions of the cameras
    space = rrb.Spatial3DView(
        origin="world",
        # Keypoints are shown on the flat image only; on the frustum they would hide the image.
        contents=["$origin/**", "- /world/camera/image/keypoints", "- /world/camera/image/motion", f"- /{ARROWS}"],
        name="map: estimate blue, ground truth orange",
        defaults=no_axes,
        line_grid=False,
        # Behind, above and beside the first camera; the unit is the median depth of the landmarks.
        eye_controls=rrb.EyeControls3D(position=(-0.4, -0.45, -0.65), look_target=(0.0, 0.0, 0.8), eye_up=(0, -1, 0)),
    )
    # Without eye controls the viewer fits the view to its content, also if the path is short.
    keyframes = rrb.Spatial3DView(
        origin="world",
        contents=["/world/trajectory/**", "/world/keyframes/**"],
        name="keyframes",
        defaults=no_axes,
        line_grid=False,
    )
    return space, keyframes


def name_parts(part: Any, path: str) -> None:
    """Replace the random ids of a layout by ids that depend on the position of each part.

    Parameters
    ----------
    part : rerun.blueprint.Container or View
        The part, with its contents.
    path : str
        Position of the part.
    """
    part.id = uuid.uuid5(uuid.NAMESPACE_URL, path)
    for i, child in enumerate(getattr(part, "contents", ())):
        if hasattr(child, "id"):
            name_parts(child, f"{path}/{i}")
