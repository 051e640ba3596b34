"""The worst cases, to be looked at: false maps first, each with its first and last keyframe."""

from __future__ import annotations

import base64
from collections import Counter
from dataclasses import dataclass

import numpy as np

from slam_init.compare.aggregate import TrialTable
from slam_init.compare.sources import open_compared
from slam_init.datasets.points import PointSource
from slam_init.errors import SlamInitError
from slam_init.recording.images import bgr, reduced
from slam_init.types.arrays import Image

__all__ = ["WorstCase", "worst_cases"]

#: So many can be looked at; no more than two of a method in a scene, so that all kinds are seen.
_CASES, _ALIKE = 12, 2
_THUMBNAIL_PX, _JPEG_QUALITY = 400, 70
_LINE, _GAP_PX = (70, 200, 255), 4


@dataclass(frozen=True)
class WorstCase:
    """A trial, and its picture as the content of a JPEG in base64; empty where there is none."""

    row: int
    picture: str


def worst_cases(table: TrialTable, texts: dict[str, str]) -> list[WorstCase]:
    """The false maps, the worst first, then the least correct ones.

    Parameters
    ----------
    table : TrialTable
    texts : dict of str to str
        Label of each source to what opens it.
    """
    outcome = table.text["outcome"]
    rotation = np.nan_to_num(table.numbers["rotation_error_deg"], nan=0.0)
    direction = np.nan_to_num(table.numbers["direction_error_deg"], nan=0.0)
    error = np.maximum(rotation / 5, direction / 15)
    shown = np.flatnonzero((outcome == "false") | (outcome == "correct"))
    # A correct map among the worst is one that nearly was not.
    shown = shown[(outcome[shown] == "false") | (error[shown] > 0.5)]
    order = shown[np.lexsort((-error[shown], outcome[shown] != "false"))]
    alike: Counter[tuple[str, str]] = Counter()
    cases: list[WorstCase] = []
    for row in order.tolist():
        kind = table.text["method"][row], table.text["group"][row]
        alike[kind] += 1
        if alike[kind] <= _ALIKE:
            frames = [int(frame) for frame in table.text["keyframes"][row].split()]
            cases.append(WorstCase(row, _picture(texts[table.text["source"][row]], frames[0], frames[-1])))
        if len(cases) == _CASES:
            break
    return cases


def _picture(text: str, first: int, last: int) -> str:
    import cv2

    try:
        source = open_compared(text)
        images = [_thumbnail(next(source.frames(frame, 1)).image) for frame in (first, last)]
    except (SlamInitError, StopIteration):
        return ""  # the data are gone since: the case is told without its picture
    if isinstance(source, PointSource):
        images = [_thumbnail(_motion(source, first, last))]
    height = min(image.shape[0] for image in images)
    gap = np.full((height, _GAP_PX, 3), 128, np.uint8)
    parts = [part for image in images for part in (image[:height], gap)][:-1]
    _, encoded = cv2.imencode(".jpg", np.concatenate(parts, axis=1), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return base64.b64encode(encoded.tobytes()).decode()


def _thumbnail(image: Image) -> Image:
    return bgr(reduced(image, _THUMBNAIL_PX))


def _motion(source: PointSource, first: int, last: int) -> Image:
    """How the tracks move between two frames."""
    import cv2

    camera = source.camera
    image = np.full((camera.height, camera.width, 3), 30, np.uint8)
    ids1, pixels1 = source.sequence.observe(first)
    ids2, pixels2 = source.sequence.observe(last)
    _, i, j = np.intersect1d(ids1, ids2, assume_unique=True, return_indices=True)
    for a, b in zip(np.round(pixels1[i]).astype(int), np.round(pixels2[j]).astype(int), strict=True):
        cv2.line(image, (int(a[0]), int(a[1])), (int(b[0]), int(b[1])), _LINE, 1, cv2.LINE_AA)
        cv2.circle(image, (int(b[0]), int(b[1])), 2, (240, 240, 240), -1, cv2.LINE_AA)
    return np.asarray(image, np.uint8)
