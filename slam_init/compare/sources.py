"""The sequences of a comparison: how to open them, and the start frames of trials."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias
from urllib.parse import parse_qsl, urlencode

import numpy as np

from slam_init.compare.criteria import NOT_EVALUATED, Criteria, criteria_of, group_of_scene
from slam_init.datasets import detect_kind, open_source
from slam_init.datasets.synth import POINTS, PREFIX, PointSource, open_points
from slam_init.datasets.views import DerivedSource, SourceView
from slam_init.errors import CalibrationError, SourceError
from slam_init.system.regular_file import user_path
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, TimedSource

#: A source of images or of points.
AnySource: TypeAlias = TimedSource | PointSource

#: Excluded: a person holds the chessboard in front of a fixed camera, so no single motion explains the image.
_SEVERAL_MOTIONS = ("opencv_chessboard",)


@dataclass(frozen=True)
class ComparedSource:
    """Description of a sequence, as it is sent to workers."""

    #: Name in the results, unique.
    label: str
    #: Trials of one group are counted together. The group of a synthetic world is its scene with what its options
    #: make difficult, and otherwise the label.
    group: str
    #: Argument of :func:`open_compared`.
    text: str
    #: Number of frames.
    frames: int
    #: Frames per second: the inverse of the median step of the time stamps.
    fps: float
    #: Whether the source has a ground truth.
    has_truth: bool

    @property
    def criteria(self) -> Criteria:
        """Return the criteria by which the maps of the source are classified.

        * Returns: Those of its group; :data:`slam_init.compare.criteria.NOT_EVALUATED` if there is no ground truth. A
          camera that is known not to translate is evaluated without one.
        """
        criteria = criteria_of(self.group)
        return criteria if self.has_truth or criteria.no_translation else NOT_EVALUATED


def open_compared(text: str) -> AnySource:
    """Open a source of a comparison.

    * ``text``: A folder, a video, ``synth:NAME[?...]`` or ``points:NAME[?...]``. The last two also accept the option
      ``seed=N`` (0 by default). Or one of these with a view (:meth:`slam_init.datasets.views.SourceView.text`): then
      the frames that are used have consecutive indices. Large images are reduced, as for ``run``.
    """
    from slam_init.runner import reduction_of

    source = _named(text)
    if isinstance(source, PointSource) or source.camera is None:
        return source
    reduction = reduction_of(source, source.camera)
    return source if reduction.factor == 1 else _Reduced(source, reduction.camera, reduction.frames)


def _named(text: str) -> AnySource:
    """Open a source with its own calibration, and with images of their own size."""
    view, text = SourceView.parse(text)
    if not text.startswith((PREFIX, POINTS)):
        return view.apply(open_source(text), renumbered=True)
    name, _, query = text.partition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    seed = options.pop("seed", "0")
    if not seed.isdecimal():
        raise SourceError(f"{text}: the seed is {seed!r}: give an integer that is at least 0")
    name = f"{name}?{urlencode(options)}" if options else name
    if not name.startswith(POINTS):
        return view.apply(open_source(name, int(seed)), renumbered=True)
    if view.query:
        raise SourceError(f"{text}: has no images to leave out or to mask: compare it without these options")
    return open_points(name, int(seed))


def calibration_of(source: AnySource, text: str) -> Camera:
    """Return the camera of a source."""
    if source.camera is None:
        raise CalibrationError(f"{text} has no calibration: give --camera FILE, or put a camera.yaml beside its images")
    return source.camera


def focal_error_of(label: str) -> float:
    """Return the relative error of the focal length that a synthetic source states.

    * Returns: Value of the option ``focal_error``: (stated - true) / true. 0 for all other sources.
    """
    return float(dict(parse_qsl(label.partition("?")[2])).get("focal_error", 0.0))


def describe_sources(texts: Sequence[str], view: SourceView | None = None) -> list[ComparedSource]:
    """Open every source once and describe it.

    * ``texts``: What the user typed. A folder that is not a sequence stands for all sequences below it.
    * Returns: In the given order; the sequences below a folder in alphabetical order.
    """
    found: list[ComparedSource] = []
    for text in texts:
        found += [_describe(label, (view or SourceView()).text(each)) for label, each in _expand(text)]
    for label, count in Counter(source.label for source in found).items():
        if count > 1:
            raise SourceError(f"{label} is given twice: give each source once")
    return found


@dataclass(frozen=True, eq=False)
class _Reduced(DerivedSource):
    """A source of large images at the size at which ``slam-init run`` tracks them."""

    reduced_camera: Camera
    reduced: Callable[[Iterator[Frame]], Iterator[Frame]]

    @property
    def camera(self) -> Camera:
        """The camera of the reduced frames."""
        return self.reduced_camera

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read and reduce frames in order."""
        return self.reduced(self.source.frames(start, max_frames))


def _expand(text: str) -> list[tuple[str, str]]:
    """Return (label, text) of each sequence that the user's text stands for."""
    if text.startswith(POINTS):
        return [(text, text)]
    path = user_path(text)
    try:
        kind = detect_kind(text)
    except SourceError:
        cameras = path.rglob("camera.yaml") if path.is_dir() else iter(())
        folders = [camera.parent for camera in cameras if (camera.parent / "groundtruth.txt").is_file()]
        below = sorted(f.relative_to(path).as_posix() for f in folders if f.name not in _SEVERAL_MOTIONS)
        if not below:
            raise
        return [(label, str((path / label).resolve())) for label in below]
    return [(text, text)] if kind in ("synth", "python") else [(path.as_posix().rstrip("/"), str(path.resolve()))]


def _describe(label: str, text: str) -> ComparedSource:
    source = open_compared(text)
    calibration_of(source, text)
    return ComparedSource(
        label=label,
        group=group_of_scene(label) if source.kind in ("synth", "points") else label,
        text=text,
        frames=len(source),
        fps=float(1 / np.median(np.diff(source.timestamps_s))) if len(source) > 1 else 0.0,
        has_truth=source.groundtruth is not None,
    )
