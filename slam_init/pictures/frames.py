"""Draws frames with their tracks, and pairs with their matches."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam_init.pictures.canvas import FAINT, INK, INLIER, MOVING, OUTLIER, TRACK
from slam_init.recording.images import bgr
from slam_init.recording.pair_view import match_parts
from slam_init.recording.story import ShownFrame, ShownPair
from slam_init.types.arrays import Bools, Floats, Image

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: More lines between the images of a pair cannot be distinguished.
_MOST_LINES = 90
#: Images that are wider than this are put one above the other.
WIDE = 1.8
#: The parts of the matches, their names in the legend and their colours, from the lowest to the highest.
_PARTS = (
    ("tracks", "tracks, no motion estimated", TRACK),
    ("outliers", "outliers", OUTLIER),
    ("inliers", "inliers", INLIER),
    ("moving", "moving objects", MOVING),
)
#: Longest track that is plotted from one shown frame to the next, as a share of the width of the image.
_LONGEST_TAIL = 0.15


def draw_frame(
    axes: Axes, shown: ShownFrame, before: ShownFrame | None, width: int, landmarks: Bools | None = None
) -> None:
    """Draw a frame, its tracks, and how the tracks moved since an earlier frame: ``landmarks`` (N,)."""
    from matplotlib.collections import LineCollection

    _image(axes, bgr(shown.image)[..., ::-1])
    axes.set_title(f"frame {shown.index}", fontsize=9, color=FAINT, pad=3)
    scale = shown.image.shape[1] / width
    places = _shown(shown.pixels, scale)
    if before is not None:
        _, i, j = np.intersect1d(before.track_ids, shown.track_ids, return_indices=True)
        # A longer one is no path of a point: descriptors linked the frames, as photographs and after a cut.
        flowed = np.linalg.norm(shown.pixels[j] - before.pixels[i], axis=1) <= _LONGEST_TAIL * width
        tails = np.stack([_shown(before.pixels[i[flowed]], scale), places[j[flowed]]], axis=1)
        axes.add_collection(LineCollection(list(tails), colors=TRACK, linewidths=0.6, alpha=0.7), autolim=False)
    chosen = np.zeros(len(places), bool) if landmarks is None else landmarks
    for part, color in ((places[~chosen], TRACK), (places[chosen], INLIER)):
        axes.plot(part[:, 0], part[:, 1], ".", color=color, markersize=3.0, markeredgewidth=0)


def draw_pair(axes: Axes, pair: ShownPair, width: int) -> None:
    """Draw two images side by side with their matches; wide images one above the other."""
    from matplotlib.collections import LineCollection

    attempt = pair[2]
    first, second = (bgr(image)[..., ::-1] for image in pair[:2])
    height, wide = first.shape[0], first.shape[1] > WIDE * first.shape[0]
    gap = np.full((4, first.shape[1], 3) if wide else (height, 4, 3), 255, np.uint8)
    _image(axes, np.concatenate([first, gap, second], axis=0 if wide else 1))
    offset = np.array((0, height + 4) if wide else (first.shape[1] + 4, 0), float)
    scale = first.shape[1] / width
    ends = np.stack([_shown(attempt.pixels1, scale), _shown(attempt.pixels2, scale) + offset], axis=1)
    sparse = np.arange(len(ends)) % max(1, -(-len(ends) // _MOST_LINES)) == 0
    parts = match_parts(attempt)
    for name, label, color in _PARTS:
        chosen = parts[name]
        if chosen.any():
            lines = LineCollection(list(ends[chosen & sparse]), colors=color, linewidths=0.6, alpha=0.8)
            axes.add_collection(lines, autolim=False)
            x, y = ends[chosen].reshape(-1, 2).T
            label = f"{label}: {np.count_nonzero(chosen)}"
            axes.plot(x, y, ".", color=color, markersize=2.2, markeredgewidth=0, label=label)
    title = f"the pair: frames {attempt.frames[0]} and {attempt.frames[1]}"
    axes.set_title(title, loc="left", color=INK, weight="bold")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.01), ncol=3, fontsize=9, markerscale=5, borderpad=0.2)


def _shown(pixels: Floats, scale: float) -> Floats:
    """Pixels of the image as it was read -> pixels of its small copy, both with centres at integers."""
    return (pixels + 0.5) * scale - 0.5


def _image(axes: Axes, rgb: Image) -> None:
    axes.imshow(rgb, interpolation="bilinear")
    axes.autoscale(False)
    axes.axis("off")
