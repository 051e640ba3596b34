"""The layout of a recording in the viewer, and the figures that it plots."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from slam_init.types.refusal import GateName
from slam_init.types.result import Attempt

Color = tuple[int, int, int]

ESTIMATE_COLOR: Color = (60, 160, 255)
TRUTH_COLOR: Color = (255, 150, 40)
GREEN: Color = (60, 200, 90)
RED: Color = (230, 70, 70)
YELLOW: Color = (255, 200, 40)
PURPLE: Color = (190, 120, 230)
#: The terms of the risk in the plot: none of the colours above, since those mean something else in the other views.
_TERM_COLORS: tuple[Color, ...] = ((120, 200, 255), (255, 160, 200), (160, 160, 160), (200, 150, 100))

TRACKS = "stats/counts/tracks"
ERROR = "stats/bundle/error"
ERROR_BARS = "stats/bundle/error_bars"
#: Of the newest camera while there is no map, in degrees.
ROTATION_SIGMA = "stats/direction/rotation"
FRAME_TIME = "stats/time/frame"
FRAME_BUDGET = "stats/time/budget"
#: Time between two frames of a camera at 30 Hz.
BUDGET_MS = 1000 / 30


@dataclass(frozen=True)
class Series:
    """A plotted figure."""

    #: Path of the entity; its last but one part names the plot.
    entity: str
    #: Name in the legend.
    label: str
    #: (int, int, int) RGB, 0 to 255.
    color: Color
    #: Returns the figure of an attempt, or None if the attempt does not have it. None if the figure does not come
    #: from an attempt.
    of_attempt: Callable[[Attempt], float | None] | None = None


def _gate(name: GateName, number: str) -> Callable[[Attempt], float | None]:
    """Return a function that returns the value or the threshold of a gate of an attempt."""
    return lambda attempt: next((getattr(gate, number) for gate in attempt.gates if gate.name is name), None)


def _evidence(part: str, name: str) -> Callable[[Attempt], float | None]:
    """Return a function that returns a figure of the evidence of an attempt."""
    return lambda attempt: None if getattr(attempt, part) is None else getattr(getattr(attempt, part), name)


def _power(figure: Callable[[Attempt], float | None]) -> Callable[[Attempt], float | None]:
    """Return a function that returns a risk as a power of ten."""

    def power(attempt: Attempt) -> float | None:
        risk = figure(attempt)
        return None if risk is None or not math.isfinite(risk) else math.log10(max(risk, LEAST_RISK))

    return power


#: What the correction of a rolling shutter moves: the measured pixels, the corrected ones, and arrows. The arrows are
#: shown this many times as long, since most are some pixels.
ARROWS, ARROW_FACTOR = "world/camera/image/readout", 4
#: The two maps of an undecided plane, and the evidence that has to decide between them.
CANDIDATES = "candidates"
#: The verdict and the advice of the run.
ADVICE = "advice"
#: The smallest risk that is plotted. The plot is of powers of ten, because the bound would lie on the axis otherwise.
LEAST_RISK = 1e-4
#: The figures that show the progress of an initialization. First the parallax grows. Then the standard deviation of the
#: direction falls, and the risk falls below its bound.
SERIES = (
    Series(TRACKS, "tracks", ESTIMATE_COLOR),
    Series("stats/counts/landmarks", "landmarks", GREEN, _gate(GateName.LANDMARKS, "value")),
    Series("stats/parallax/median", "median", ESTIMATE_COLOR, _evidence("preview", "parallax_px")),
    Series("stats/shares/parallax", "with parallax", ESTIMATE_COLOR, _evidence("preview", "parallax_share")),
    Series("stats/direction/sigma", "standard deviation", ESTIMATE_COLOR, _evidence("window", "direction_sigma_deg")),
    Series(ROTATION_SIGMA, "rotation of the camera", YELLOW),
    Series("stats/readout/estimate", "rolling shutter", ESTIMATE_COLOR, _evidence("window", "readout_ms")),
    Series("stats/risk_log10/bound", "bound", RED, _power(_gate(GateName.RISK, "threshold"))),
    Series("stats/risk_log10/direction", "direction", _TERM_COLORS[0], _power(_evidence("window", "risk_direction"))),
    Series("stats/risk_log10/competing", "competing", _TERM_COLORS[1], _power(_evidence("window", "risk_competing"))),
    Series("stats/risk_log10/rotation", "rotation", _TERM_COLORS[2], _power(_evidence("window", "risk_rotation"))),
    Series("stats/risk_log10/moving", "moving", _TERM_COLORS[3], _power(_evidence("window", "risk_moving"))),
    Series("stats/risk_log10/total", "risk", PURPLE, _power(_evidence("window", "risk"))),
    Series(ERROR, "rms residual", ESTIMATE_COLOR),
    Series(FRAME_TIME, "frame", ESTIMATE_COLOR),
    Series(FRAME_BUDGET, "30 Hz", RED),
)


#: What is shown on the flat image only. On the frustum it would hide the image.
_FLAT = ("keypoints", "motion", "moving")


class End(StrEnum):
    """What a recording shows first: the map of a run, both undecided maps, or why there is no map.

    The tabs have this order.
    """

    MAP = "map"
    CANDIDATES = "candidates"
    NO_MAP = "no map"


def blueprint(end: End = End.MAP, *, rolling: bool = False) -> Any:
    """Make the layout of four panels: the map, large, over the texts; the frame over the plots.

    * ``rolling``: Whether the view of the rolling shutter is in front of that of the frame.
    """
    advice = rrb.TextDocumentView(origin=ADVICE, name="result")
    # From behind, above and beside the first camera; the unit is the median depth of the landmarks.
    behind = rrb.EyeControls3D(position=(-0.4, -0.45, -0.65), look_target=(0.0, 0.0, 0.8), eye_up=(0, -1, 0))
    no_axes = [rr.TransformAxes3D(0.0)]  # the frusta show the directions of the cameras
    space = rrb.Spatial3DView(
        origin="world",
        # Keypoints are shown on the flat image only; on the frustum they would hide the image.
        contents=["$origin/**", *(f"- /world/camera/image/{name}" for name in _FLAT), f"- /{ARROWS}/**"],
        name="map: estimate blue, truth orange, newest frame yellow",
        defaults=no_axes,
        line_grid=False,
        eye_controls=behind,
    )
    # Without eye controls the viewer fits the view to its content, also if the path is short.
    paths = ["/world/trajectory/**", "/world/keyframes/**"]
    keyframes = rrb.Spatial3DView(origin="world", contents=paths, name="keyframes", defaults=no_axes, line_grid=False)
    # Names are short, since the viewer cuts them: in a window of 1280 pixels all four have 45 letters.
    image = "world/camera/image"
    frame = rrb.Spatial2DView(origin=image, contents=["$origin/**", f"- /{ARROWS}/**"], name="frame")
    shutter = rrb.Spatial2DView(origin=image, contents=[f"/{image}", f"/{ARROWS}/**"], name="shutter")
    pair = rrb.Spatial2DView(origin="pairs/image", name="pair")
    images = rrb.Tabs(frame, pair, keyframes, shutter, active_tab=3 if rolling else int(end is not End.MAP))
    maps = rrb.Tabs(space, _conjugate_maps(), advice, active_tab=list(End).index(end))
    left = rrb.Vertical(maps, _texts(), row_shares=[7, 3])
    right = rrb.Vertical(images, _plots(), row_shares=[1, 1])
    root = rrb.Horizontal(left, right, column_shares=[5, 3])
    name_parts(root, f"slam-init {end} {rolling}")
    return rrb.Blueprint(root, rrb.TimePanel(timeline="frame", state="collapsed"), collapse_panels=True)


def _conjugate_maps() -> Any:
    """Make the view of both undecided maps, side by side, over the evidence that has to decide."""
    # From above, the planes of both maps are lines of different directions.
    above = rrb.EyeControls3D(position=(0.0, -1.7, 0.0), look_target=(0.0, 0.0, 0.7), eye_up=(0, 0, 1))
    views = [
        rrb.Spatial3DView(origin=f"{CANDIDATES}/{name}", name=title, line_grid=False, eye_controls=above)
        for name, title in (("a", "map A: fits better"), ("b", "map B: the other"))
    ]
    return rrb.Vertical(
        rrb.Horizontal(*views),
        rrb.TextDocumentView(origin=f"{CANDIDATES}/evidence", name="what has to decide between A and B"),
        row_shares=[2, 1],
        name="both maps",
    )


def _texts() -> Any:
    log = rrb.TextLogView(
        origin="log", name="log", columns=rrb.TextLogColumns(timeline_columns=["frame"], text_log_columns=["Body"])
    )
    return rrb.Tabs(
        rrb.TextDocumentView(origin="pairs/verdict", name="verdict on the pair"),
        log,
        rrb.TextDocumentView(origin="pairs/evidence", name="evidence"),
        name="text",
    )


def _plots() -> Any:
    """Make the plots: the risk in front, its parts, the time of a frame, and the rest side by side.

    The parts of the risk are a tab of their own: over a hundred frames without a map they hide the risk. A legend would
    hide a part of a plot of this size. The names of the lines have their colours.
    """
    hidden = rrb.PlotLegend(visible=False)

    def plot(name: str, of: str, contents: Any = "$origin/**", axis_y: Any = None) -> Any:
        return rrb.TimeSeriesView(origin=f"stats/{of}", contents=contents, name=name, plot_legend=hidden, axis_y=axis_y)

    whole = ["/stats/risk_log10/total", "/stats/risk_log10/bound"]
    parts = ["$origin/**", *(f"- {entity}" for entity in whole)]
    powers = rrb.ScalarAxis(range=(math.log10(LEAST_RISK) - 0.2, 0.2))
    # An evaluation in one piece takes a second; on its scale the budget would lie on the axis.
    times = rrb.ScalarAxis(range=(0.0, 5 * BUDGET_MS))
    more = rrb.Grid(
        plot("parallax px", "parallax"),
        plot("counts", "counts"),
        plot("sigma deg", "direction"),
        plot("shares", "shares"),
        plot("readout ms", "readout"),
        rrb.BarChartView(origin=ERROR_BARS, name="BA rms px", plot_legend=hidden),
        grid_columns=2,
        name="more",
    )
    return rrb.Tabs(
        plot("log10 risk (bound red)", "risk_log10", whole, powers),
        plot("parts", "risk_log10", parts, powers),
        plot("ms", "time", axis_y=times),
        more,
    )


def name_parts(part: Any, path: str) -> None:
    """Replace the random ids of a layout by ids that depend on the position of each part."""
    part.id = uuid.uuid5(uuid.NAMESPACE_URL, path)
    for i, child in enumerate(getattr(part, "contents", ())):
        if hasattr(child, "id"):
            name_parts(child, f"{path}/{i}")
