"""The view of a pair: two images side by side, and the matches as lines between them."""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_init.recording.images import RecentImages, bgr, jpeg, reduced_shape
from slam_init.recording.layout import GREEN, PURPLE, RED, YELLOW
from slam_init.types.camera import Camera
from slam_init.types.result import Attempt

#: At most this many matches are drawn as lines, since more lines cannot be told apart. All matches are drawn as points.
_MAX_LINES = 120
#: The images of a pair are put one above the other if width divided by height is larger than this.
_WIDE = 1.8


def log_pair(rec: Any, attempt: Attempt, recent: RecentImages, camera: Camera) -> None:
    """Log the images and the matches of a pair.

    * ``attempt``: With its matches. Where no motion was estimated, they are neither inliers nor outliers.
    """
    import rerun as rr

    images = [recent.get(index) for index in attempt.frames[:2]]
    shape = reduced_shape(camera.height, camera.width, recent.long_side_px)
    blank = np.full((*shape, 3), 40, np.uint8)
    left, right = (blank if image is None else bgr(image) for image in images)
    wide = shape[1] > _WIDE * shape[0]
    rec.log("pairs/image", jpeg(np.concatenate([left, right], axis=0 if wide else 1)))

    factor = shape[1] / camera.width
    second = (0, shape[0]) if wide else (shape[1], 0)
    points1 = (attempt.pixels1 + 0.5) * factor
    points2 = (attempt.pixels2 + 0.5) * factor + second
    matches = np.stack([points1, points2], axis=1)
    step = max(1, -(-len(matches) // _MAX_LINES))
    drawn = np.arange(len(matches)) % step == 0
    moving = (attempt.moving if attempt.moving.size else np.zeros_like(attempt.inliers)) & ~attempt.inliers
    others = ~attempt.inliers & ~moving
    parts = (
        ("inliers", attempt.inliers, GREEN),
        ("outliers", others & attempt.judged, RED),
        ("moving", moving, PURPLE),
        ("tracks", others & (not attempt.judged), YELLOW),
    )
    for name, chosen, color in parts:
        rec.log(
            f"pairs/image/{name}",
            rr.LineStrips2D(matches[chosen & drawn], colors=[(*color, 150)], radii=rr.Radius.ui_points(0.5)),
        )
        rec.log(
            f"pairs/image/{name}/points",
            rr.Points2D(matches[chosen].reshape(-1, 2), colors=[color], radii=rr.Radius.ui_points(1.5)),
        )
