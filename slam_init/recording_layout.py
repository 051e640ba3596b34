"""How the viewer lays a recording out. Used by :mod:`slam_init.recording` only."""

from __future__ import annotations

import uuid
from typing import Any

__all__ = ["blueprint"]


def blueprint() -> Any:
    """The map at the left; image, pair, series, log and summary at the right."""
    import rerun as rr
    import rerun.blueprint as rrb

    space = rrb.Spatial3DView(
        origin="world",
        # Keypoints belong on the flat image; painted on a frustum they hide it.
        contents=["$origin/**", "- /world/camera/image/keypoints", "- /world/camera/image/motion"],
        name="map",
        defaults=[rr.TransformAxes3D(0.0)],  # the frusta show where a camera looks
        line_grid=False,
        # Behind and above the first camera; the unit is the median depth of the landmarks.
        eye_controls=rrb.EyeControls3D(position=(-0.25, -0.3, -0.55), look_target=(0.0, 0.05, 0.6), eye_up=(0, -1, 0)),
    )
    camera = rrb.Spatial2DView(origin="world/camera/image", name="frame and tracks")
    pair = rrb.Spatial2DView(origin="pairs/image", name="pair tried: inliers green, outliers red")
    verdict = rrb.TextDocumentView(origin="pairs/verdict", name="verdict")
    legend = rrb.PlotLegend(visible=True)
    series = [
        rrb.TimeSeriesView(origin=f"stats/{unit}", name=name, plot_legend=legend)
        for unit, name in (("px", "attempts, pixels"), ("deg", "attempts, degrees"))
    ]
    tracks = rrb.TimeSeriesView(origin="stats/tracks", name="tracks", plot_legend=legend)
    bundle = rrb.BarChartView(
        origin="stats/bundle/error_bars",
        name="BA error by iteration",
        plot_legend=rrb.PlotLegend(visible=False),
    )
    iterations = rrb.TimeSeriesView(origin="stats/bundle/error", name="BA error (timeline ba_iter)", plot_legend=legend)
    log = rrb.TextLogView(origin="log", name="log")
    summary = rrb.TextDocumentView(origin="summary", name="summary")
    root = rrb.Horizontal(
        rrb.Vertical(
            space,
            rrb.Tabs(log, summary, iterations, name="text"),
            row_shares=[3, 1],
        ),
        rrb.Vertical(
            rrb.Horizontal(camera, verdict, column_shares=[3, 2]),
            pair,
            rrb.Horizontal(rrb.Tabs(*series), tracks, bundle),
            row_shares=[3, 3, 2],
        ),
        column_shares=[1, 1],
    )
    _name(root, "slam-init")
    return rrb.Blueprint(root, rrb.TimePanel(timeline="frame", state="collapsed"), collapse_panels=True)


def _name(part: Any, path: str) -> None:
    """Replace the random ids of a layout by ids made from the place of each part."""
    part.id = uuid.uuid5(uuid.NAMESPACE_URL, path)
    for i, child in enumerate(getattr(part, "contents", ())):
        if hasattr(child, "id"):
            _name(child, f"{path}/{i}")
