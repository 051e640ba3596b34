"""The galleries of the report: its worst maps, trials without a map, and a picture of each scene."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from slam_init.compare.judging import criteria_of
from slam_init.compare.sources import ComparedSource, open_compared
from slam_init.compare.trial_table import TrialTable
from slam_init.datasets.points import POINTS, PointSource
from slam_init.errors import SlamInitError
from slam_init.methods.external_command import method_label
from slam_init.recording.images import bgr, reduced
from slam_init.types.arrays import Image
from slam_init.types.reasons import in_words

if TYPE_CHECKING:
    from slam_init.compare.plan import Plan

#: Number of cases that a reader can look at.
_MAX_CASES = 12
#: Largest number of cases of one method in one scene, so that the gallery shows different kinds of failures.
_MAX_ALIKE = 2
#: Only correct maps with an error above this share of a bound are shown.
_MIN_ERROR = 0.5
_THUMBNAIL_PX, _JPEG_QUALITY = 400, 70
#: Size and number of the pictures of scenes: 40 of them add 150 kB to the page.
_SMALL_PX, _MAX_THUMBNAILS = 96, 40
_LINE_BGR, _GAP_PX = (70, 200, 255), 4


@dataclass(frozen=True)
class _Case:
    """A trial that may be shown."""

    #: Row of the trial in the table.
    row: int
    #: The frames of its picture; None where they are not known.
    frames: tuple[int, int] | None
    #: What happened, and where: HTML.
    fact: str
    place: str


def worst_cases(table: TrialTable, plan: Plan) -> str:
    """Show the worst trials: false maps first, then correct maps near a bound; each by decreasing error."""
    cases = _gallery(table, plan, _worst(table), _MAX_ALIKE, "first and last keyframe")
    return cases or "<p>None: no map is false, and no error is above half of a bound.</p>"


def waiting_cases(table: TrialTable, plan: Plan) -> str:
    """Show trials without a map in which a map can be correct: one of each method and scene, most frames first."""
    cases = _gallery(table, plan, _waiting(table), 1, "first and last frame that the method could read")
    return cases or "<p>None: each solvable trial has a map.</p>"


def _worst(table: TrialTable) -> Iterator[_Case]:
    outcome = table["outcome"]
    errors = {name: table[f"{name}_error_deg"] for name in ("rotation", "direction")}
    rotation, direction = (np.nan_to_num(error, nan=0.0) for error in errors.values())
    criteria = {group: criteria_of(group) for group in set(table["group"])}
    of_row = [criteria[group] for group in table["group"]]
    # A direction that is not judged has no error.
    error = np.maximum(
        rotation / np.array([c.rotation_deg for c in of_row]),
        direction / np.array([c.direction_deg or np.inf for c in of_row]),
    )
    shown = np.flatnonzero((outcome == "false") | ((outcome == "correct") & (error > _MIN_ERROR)))
    for row in shown[np.lexsort((-error[shown], outcome[shown] != "false"))].tolist():
        # A row of a journal from elsewhere may have no keyframes.
        frames = [int(frame) for frame in table["keyframes"][row].split()]
        known = [f"{name} {values[row]:.1f}&deg;" for name, values in errors.items() if np.isfinite(values[row])]
        between = f", keyframes {frames[0]} and {frames[-1]}" if frames else ""
        yield _Case(
            row,
            (frames[0], frames[-1]) if frames else None,
            ", ".join(known) or "no true baseline",
            f"start {table['start'][row]:.0f}{between}",
        )


def _waiting(table: TrialTable) -> Iterator[_Case]:
    outcome = table["outcome"]
    waiting = np.flatnonzero(table["solvable"] & ((outcome == "none") | (outcome == "error")))
    starts, limits = (table[name].astype(int) for name in ("start", "frames_limit"))
    for row in waiting[np.argsort(-limits[waiting], kind="stable")].tolist():
        first, last = int(starts[row]), int(starts[row] + limits[row] - 1)
        reason = escape(in_words(table["reason"][row])) or "no reason"
        yield _Case(row, (first, last), reason, f"frames {first} to {last}")


def _gallery(table: TrialTable, plan: Plan, cases: Iterable[_Case], most_alike: int, alt: str) -> str:
    """Show the first cases, so many of a method in a scene, each with its first and its last frame."""
    texts = {source.label: source.text for source in plan.sources}
    alike: Counter[tuple[str, str]] = Counter()
    shown: list[str] = []
    for case in cases:
        method, group, source, outcome = (table[name][case.row] for name in ("method", "group", "source", "outcome"))
        alike[method, group] += 1
        if alike[method, group] > most_alike:
            continue
        picture = _picture(texts[source], *case.frames) if case.frames else ""
        image = f'<img alt="{alt}" src="data:image/jpeg;base64,{picture}">' if picture else ""
        shown.append(
            f'<div class="case">{image}<p><span class="tag {outcome}">{outcome}</span> '
            f"<b>{escape(method_label(method))}</b> {case.fact}<br>"
            f'<span class="soft">{escape(source)}, {case.place}</span></p></div>'
        )
        if len(shown) == _MAX_CASES:
            break
    return f'<div class="cases">{"".join(shown)}</div>' if shown else ""


def thumbnails(sources: Sequence[ComparedSource]) -> dict[str, str]:
    """Draw a small picture of each scene: the first frame of its first sequence.

    * Returns: JPEG file in base64 by scene, for the first 40 scenes. Tracks without images have no picture.
    """
    first: dict[str, str] = {}
    for source in sources:
        if not source.text.startswith(POINTS):
            first.setdefault(source.group, source.text)
    drawn = {}
    for group, text in list(first.items())[:_MAX_THUMBNAILS]:
        try:
            image = next(open_compared(text).frames(0, 1)).image
        except (SlamInitError, StopIteration):  # the source can no longer be read
            continue
        drawn[group] = _encoded(bgr(reduced(image, _SMALL_PX)))
    return drawn


def _picture(text: str, first: int, last: int) -> str:
    """Draw two frames of a source, or the motion of its tracks: JPEG in base64, empty if it can no longer be read."""
    try:
        source = open_compared(text)
        if isinstance(source, PointSource):
            return _encoded(_thumbnail(_motion(source, first, last)))
        images = [_thumbnail(next(source.frames(frame, 1)).image) for frame in (first, last)]
    except (SlamInitError, StopIteration):
        return ""
    height = min(image.shape[0] for image in images)
    gap = np.full((height, _GAP_PX, 3), 128, np.uint8)
    return _encoded(np.concatenate([images[0][:height], gap, images[1][:height]], axis=1))


def _encoded(image: Image) -> str:
    import cv2

    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return base64.b64encode(encoded.tobytes()).decode()


def _thumbnail(image: Image) -> Image:
    return bgr(reduced(image, _THUMBNAIL_PX))


def _motion(source: PointSource, first: int, last: int) -> Image:
    """Draw the motion of the tracks between two frames."""
    import cv2

    camera = source.camera
    image = np.full((camera.height, camera.width, 3), 30, np.uint8)
    ids1, pixels1 = source.sequence.observe(first)
    ids2, pixels2 = source.sequence.observe(last)
    _, i, j = np.intersect1d(ids1, ids2, assume_unique=True, return_indices=True)
    for a, b in zip(np.round(pixels1[i]).astype(int), np.round(pixels2[j]).astype(int), strict=True):
        cv2.line(image, (int(a[0]), int(a[1])), (int(b[0]), int(b[1])), _LINE_BGR, 1, cv2.LINE_AA)
        cv2.circle(image, (int(b[0]), int(b[1])), 2, (240, 240, 240), -1, cv2.LINE_AA)
    return np.asarray(image, np.uint8)
