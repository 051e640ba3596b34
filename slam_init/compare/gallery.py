"""Pictures of a comparison: its worst trials, trials without a map, and its scenes."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
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
class FailureCase:
    """A trial and its picture."""

    #: Row of the trial in the table.
    row: int
    #: JPEG file in base64; empty if the source can no longer be read.
    picture: str


def failure_cases(table: TrialTable, texts: dict[str, str]) -> list[FailureCase]:
    """Choose the worst trials: false maps first, then correct maps near a bound; each by decreasing error.

    * ``texts``: Label of each source to the argument of :func:`slam_init.compare.sources.open_compared`.
    """
    outcome = table.text["outcome"]
    rotation, direction = (
        np.nan_to_num(table.numbers[f"{name}_error_deg"], nan=0.0) for name in ("rotation", "direction")
    )
    criteria = {group: criteria_of(group) for group in set(table.text["group"])}
    of_row = [criteria[group] for group in table.text["group"]]
    # A direction that is not judged has no error.
    error = np.maximum(
        rotation / np.array([c.rotation_deg for c in of_row]),
        direction / np.array([c.direction_deg or np.inf for c in of_row]),
    )
    shown = np.flatnonzero((outcome == "false") | ((outcome == "correct") & (error > _MIN_ERROR)))
    order = shown[np.lexsort((-error[shown], outcome[shown] != "false"))]
    # A row of a journal from elsewhere may have no keyframes.
    keyframes = {row: [int(frame) for frame in table.text["keyframes"][row].split()] for row in order.tolist()}
    spans = {row: (frames[0], frames[-1]) if frames else None for row, frames in keyframes.items()}
    return _cases(table, texts, spans, _MAX_ALIKE)


def waiting_cases(table: TrialTable, texts: dict[str, str]) -> list[FailureCase]:
    """Choose trials without a map in which a map can be correct: one of each method and scene, most frames first."""
    outcome = table.text["outcome"]
    waiting = np.flatnonzero(table.solvable & ((outcome == "none") | (outcome == "error")))
    starts, limits = (table.numbers[name].astype(int) for name in ("start", "frames_limit"))
    order = waiting[np.argsort(-limits[waiting], kind="stable")].tolist()
    return _cases(table, texts, {row: (starts[row], starts[row] + limits[row] - 1) for row in order}, 1)


def _cases(
    table: TrialTable, texts: dict[str, str], spans: Mapping[int, tuple[int, int] | None], most_alike: int
) -> list[FailureCase]:
    """Take the first trials, so many of a method in a scene, each with its first and its last frame."""
    alike: Counter[tuple[str, str]] = Counter()
    cases: list[FailureCase] = []
    for row, span in spans.items():
        kind = table.text["method"][row], table.text["group"][row]
        alike[kind] += 1
        if alike[kind] <= most_alike:
            cases.append(FailureCase(row, _picture(texts[table.text["source"][row]], *span) if span else ""))
        if len(cases) == _MAX_CASES:
            break
    return cases


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
    try:
        source = open_compared(text)
        images = [_thumbnail(next(source.frames(frame, 1)).image) for frame in (first, last)]
    except (SlamInitError, StopIteration):
        return ""  # the source can no longer be read: the case is shown without a picture
    if isinstance(source, PointSource):
        images = [_thumbnail(_motion(source, first, last))]
    height = min(image.shape[0] for image in images)
    gap = np.full((height, _GAP_PX, 3), 128, np.uint8)
    parts = [part for image in images for part in (image[:height], gap)][:-1]
    return _encoded(np.concatenate(parts, axis=1))


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


def gallery_section(table: TrialTable, plan: Plan) -> str:
    """Show the worst trials."""
    cases = []
    for case in failure_cases(table, {source.label: source.text for source in plan.sources}):
        errors = {name: table.numbers[f"{name}_error_deg"][case.row] for name in ("rotation", "direction")}
        known = [f"{name} {error:.1f}&deg;" for name, error in errors.items() if error == error]
        frames = table.text["keyframes"][case.row].split()
        between = f", keyframes {frames[0]} and {frames[-1]}" if frames else ""
        place = f"start {table.numbers['start'][case.row]:.0f}{between}"
        cases.append(_case(table, case, "first and last keyframe", ", ".join(known) or "no true baseline", place))
    return _section(
        "worst",
        "Worst cases",
        "False maps first, then correct maps with an error above half of a bound; at most two maps of a method in a "
        "scene. The pictures show the first and the last keyframe, or the motion of the tracks between them.",
        cases,
        "None: no map is false, and no error is above half of a bound.",
    )


def waiting_section(table: TrialTable, plan: Plan) -> str:
    """Show trials without a map although one can be correct: what the method saw, and why it has none."""
    cases = []
    for case in waiting_cases(table, {source.label: source.text for source in plan.sources}):
        start, limit = (int(table.numbers[name][case.row]) for name in ("start", "frames_limit"))
        reason = escape(table.text["reason"][case.row].replace("_", " ")) or "no reason"
        alt = "first and last frame that the method could read"
        cases.append(_case(table, case, alt, reason, f"frames {start} to {start + limit - 1}"))
    return _section(
        "waiting",
        "No map, where one can be correct",
        "Trials that ended without a map or with an error; one of each method and scene, those with the most frames "
        "first. The pictures show the first and the last frame that the method could read, or the motion of the tracks "
        "between them.",
        cases,
        "None: each solvable trial has a map.",
    )


def _case(table: TrialTable, case: FailureCase, alt: str, fact: str, place: str) -> str:
    text = {name: str(values[case.row]) for name, values in table.text.items()}
    picture = f'<img alt="{alt}" src="data:image/jpeg;base64,{case.picture}">' if case.picture else ""
    return (
        f'<div class="case">{picture}<p><span class="tag {text["outcome"]}">{text["outcome"]}</span> '
        f"<b>{escape(method_label(text['method']))}</b> {fact}<br>"
        f'<span class="soft">{escape(text["source"])}, {place}</span></p></div>'
    )


def _section(name: str, title: str, about: str, cases: Sequence[str], none: str) -> str:
    shown = f'<div class="cases">{"".join(cases)}</div>' if cases else f"<p>{none}</p>"
    return f'<h2 id="{name}">{title}</h2><p class="soft">{about}</p>{shown}'
