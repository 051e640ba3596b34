"""What is compared on: sequences with a truth, how far to trust it, and where trials start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, urlencode

import numpy as np

from slam_init.errors import CalibrationError, SourceError
from slam_init.types.arrays import Floats

if TYPE_CHECKING:
    from slam_init.datasets import TimedSource
    from slam_init.datasets.points import PointSource
    from slam_init.types.camera import Camera

__all__ = [
    "GRID",
    "ComparedSource",
    "Judging",
    "calibration_of",
    "describe_sources",
    "drawn_sources",
    "focal_error_of",
    "grid_sources",
    "judging_of",
    "open_compared",
]

#: A start must leave so many frames: half a second of video.
_LEAST_FRAMES = 15
#: The sampled grid: noise in pixels, shares of wrong matches, baseline over depth, error of the focal length.
GRID: dict[str, tuple[float, ...]] = {
    "noise_px": (0.3, 0.7, 1.0),
    "outliers": (0.05, 0.15, 0.3),
    "baseline": (0.03, 0.05, 0.1, 0.15, 0.3),
    "focal_error": (0.0, 0.02, 0.05),
}


@dataclass(frozen=True)
class Judging:
    """How results on a sequence are judged.

    Attributes
    ----------
    still : bool
        The camera never translates: every map is false.
    direction_known : bool
        False where the ground truth does not know the direction of a short baseline.
    cause : str or None
        The reason that a method should give where it finds no map.
    """

    still: bool = False
    direction_known: bool = True
    cause: str | None = None


#: Synthetic scenes in which a cause is injected.
_SCENES = {
    "static": Judging(still=True, cause="static_camera"),
    "rotation": Judging(still=True, cause="pure_rotation"),
}
#: Public sequences whose truth has limits, by the end of their path. Motion capture resolves the 2 mm by which a drone
#: on the ground trembles. Depth tracking (7-Scenes) and a rolling shutter (TUM fr1) leave errors of about ten degrees
#: in the direction of a short baseline.
_SEQUENCES = {
    "V1_01_static": Judging(still=True, cause="static_camera"),
    "redkitchen_a": Judging(direction_known=False),
    "fr1_desk_9frames": Judging(direction_known=False),
}
#: Its board is held by a person before a fixed camera: no single motion explains the image.
_NOT_ONE_MOTION = ("opencv_chessboard",)


@dataclass(frozen=True)
class ComparedSource:
    """A sequence to compare on, as it is sent to workers.

    Attributes
    ----------
    label : str
        Name in the results, unique.
    group : str
        Trials of one group are counted together: the scene of a synthetic world, else the label.
    text : str
        What :func:`open_compared` takes.
    frames : int
    fps : float
        Frames a second, by the median step of the time stamps.
    """

    label: str
    group: str
    text: str
    frames: int
    fps: float

    def starts(self, every: int) -> range:
        """Every k-th frame that leaves half a second of video; a shorter sequence is started once."""
        return range(0, max(self.frames - _LEAST_FRAMES + 1, 1), every)


def open_compared(text: str) -> TimedSource | PointSource:
    """Open a folder, a video, ``synth:NAME[?...]`` or ``points:NAME[?...]``; the last two take ``seed=N`` as well.

    Raises
    ------
    SourceError, CalibrationError
        As :func:`slam_init.datasets.open_source`.
    """
    from slam_init.datasets import open_source
    from slam_init.datasets.points import POINTS, open_points
    from slam_init.datasets.synth import PREFIX

    if not text.startswith((PREFIX, POINTS)):
        return open_source(text)
    name, _, query = text.partition("?")
    options = parse_qsl(query, keep_blank_values=True)
    seeds = [value for key, value in options if key == "seed"] or ["0"]
    if not seeds[-1].isdecimal():
        raise SourceError(f"{text}: seed is {seeds[-1]!r}: give a number that is not negative")
    rest = urlencode([(key, value) for key, value in options if key != "seed"])
    opener = open_points if name.startswith(POINTS) else open_source
    return opener(f"{name}?{rest}" if rest else name, int(seeds[-1]))


def calibration_of(source: TimedSource | PointSource, text: str) -> Camera:
    """The camera that comes with a source.

    Raises
    ------
    CalibrationError
        Where none does.
    """
    if source.camera is None:
        raise CalibrationError(f"{text} has no calibration: put a camera.yaml beside its images")
    return source.camera


def judging_of(group: str) -> Judging:
    """How the trials of a group are judged."""
    prefix, colon, scene = group.partition(":")
    if colon and prefix in ("synth", "points"):
        return _SCENES.get(scene, Judging())
    return _SEQUENCES.get(Path(group).name, Judging())


def focal_error_of(label: str) -> float:
    """By how much the stated focal length of a synthetic source is off, relative to the true one; 0 for all others."""
    name, _, query = label.partition("?")
    if not name.startswith(("synth:", "points:")):
        return 0.0
    return float(dict(parse_qsl(query)).get("focal_error", 0.0))


def describe_sources(texts: Sequence[str]) -> list[ComparedSource]:
    """Open every source once; a folder that is no sequence stands for all sequences below it.

    Raises
    ------
    SourceError, CalibrationError
        Where one cannot be read, has no calibration, or is given twice.
    """
    found: list[ComparedSource] = []
    for text in texts:
        found += [_describe(label, each) for label, each in _expand(text)]
    labels = [source.label for source in found]
    for label in labels:
        if labels.count(label) > 1:
            raise SourceError(f"{label} is given twice: give each source once")
    return found


def grid_sources(count: int, seed: int) -> list[str]:
    """Point-level sources drawn from the grid of noise, outliers, baselines and focal errors, ``count`` a scene."""
    from slam_init.datasets.points import point_scenes

    return [text for scene in point_scenes() for text in drawn_sources(scene, count, seed)]


def drawn_sources(scene: str, count: int, seed: int, **fixed: float) -> list[str]:
    """Point-level sources of a scene drawn from :data:`GRID`; an option that is fixed changes nothing in the others."""
    rng = np.random.default_rng((seed, *scene.encode()))
    texts = []
    for i in range(count):
        options = {name: float(rng.choice(values)) for name, values in GRID.items()} | fixed
        texts.append(f"points:{scene}?{urlencode({**options, 'seed': 1000 * seed + i})}")
    return texts


def _expand(text: str) -> list[tuple[str, str]]:
    """(label, text) of each sequence that the user means."""
    from slam_init.datasets import detect_kind
    from slam_init.datasets.points import POINTS

    if text.startswith(POINTS):
        return [(text, text)]
    path = Path(text).expanduser()
    try:
        kind = detect_kind(text)
    except SourceError:
        below = _sequences_below(path)
        if not below:
            raise
        return [(label, str((path / label).resolve())) for label in below]
    return [(text, text)] if kind in ("synth", "python") else [(path.as_posix().rstrip("/"), str(path.resolve()))]


def _sequences_below(path: Path) -> list[str]:
    """Folders below a folder with a camera and a true trajectory, relative to it, sorted."""
    cameras = path.rglob("camera.yaml") if path.is_dir() else iter(())
    folders = [camera.parent for camera in cameras if (camera.parent / "groundtruth.txt").is_file()]
    return sorted(f.relative_to(path).as_posix() for f in folders if f.name not in _NOT_ONE_MOTION)


def _describe(label: str, text: str) -> ComparedSource:
    source = open_compared(text)
    calibration_of(source, text)
    synthetic = source.kind in ("synth", "points")
    return ComparedSource(
        label=label,
        group=label.partition("?")[0] if synthetic else label,
        text=text,
        frames=len(source),
        fps=_fps(source.timestamps_s),
    )


def _fps(timestamps_s: Floats) -> float:
    return float(1 / np.median(np.diff(timestamps_s))) if len(timestamps_s) > 1 else 0.0
