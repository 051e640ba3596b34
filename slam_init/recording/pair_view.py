"""The view of a pair: two images side by side, and the matches as lines between them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from slam_init.recording.images import PAIR_SIDE_PX, bgr, jpeg, reduced_shape
from slam_init.recording.layout import GREEN, PURPLE, RED, YELLOW
from slam_init.recording.story import ShownFrame
from slam_init.types.arrays import Bools
from slam_init.types.camera import Camera
from slam_init.types.result import Attempt

#: At most this many matches are shown as lines, since more lines cannot be distinguished. All matches are shown as
#: points.
_MAX_LINES = 120
#: The images of a pair are put one above the other if width divided by height is larger than this.
_WIDE = 1.8


def moving_matches(attempt: Attempt) -> Bools:
    """Which matches (N,) of a pair lie on moving objects, and are no inliers of the camera."""
    return attempt.moving & ~attempt.inliers if attempt.moving.size else np.zeros_like(attempt.inliers)


def match_parts(attempt: Attempt) -> dict[str, Bools]:
    """The matches of a pair by what they are, (N,) each: without an estimated motion they are tracks only."""
    moving = moving_matches(attempt)
    others = ~attempt.inliers & ~moving
    evaluated = np.full(len(others), attempt.evaluated)
    return {"inliers": attempt.inliers, "outliers": others & evaluated, "moving": moving, "tracks": others & ~evaluated}


def log_pair(rec: Any, attempt: Attempt, recent: Mapping[int, ShownFrame], camera: Camera) -> None:
    """Log the images and the matches of a pair.

    * ``attempt``: With its matches. Where no motion was estimated, they are neither inliers nor outliers.
    """
    import rerun as rr

    shown = [recent.get(index) for index in attempt.frames[:2]]
    shape = reduced_shape(camera.height, camera.width, PAIR_SIDE_PX)
    blank = np.full((*shape, 3), 40, np.uint8)
    left, right = (blank if one is None else bgr(one.image) for one in shown)
    wide = shape[1] > _WIDE * shape[0]
    rec.log("pairs/image", jpeg(np.concatenate([left, right], axis=0 if wide else 1)))

    factor = shape[1] / camera.width
    second = (0, shape[0]) if wide else (shape[1], 0)
    points1 = (attempt.pixels1 + 0.5) * factor
    points2 = (attempt.pixels2 + 0.5) * factor + second
    matches = np.stack([points1, points2], axis=1)
    sparse = np.arange(len(matches)) % max(1, -(-len(matches) // _MAX_LINES)) == 0
    for (name, chosen), color in zip(match_parts(attempt).items(), (GREEN, RED, PURPLE, YELLOW), strict=True):
        entity = f"pairs/image/{name}"
        thin, thick = rr.Radius.ui_points(0.5), rr.Radius.ui_points(1.5)
        rec.log(entity, rr.LineStrips2D(matches[chosen & sparse], colors=[(*color, 150)], radii=thin))
        ends = matches[chosen].reshape(-1, 2)
        rec.log(f"{entity}/points", rr.Points2D(ends, colors=[color], radii=thick))
