"""One trial: a method, fed with the tracks of a sequence from one start on, until its first map or the limit."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from slam_init.attempt_log import reported_focal_factor
from slam_init.compare.measures import depth_errors, is_correct, is_strict, pose_errors, survival
from slam_init.compare.replay import Step, replay
from slam_init.compare.sources import ComparedSource, Judging, calibration_of, judging_of, open_compared
from slam_init.config import Config
from slam_init.recording.recorder import Recorder
from slam_init.types.initial_map import InitialMap
from slam_init.types.reasons import ACCEPTED
from slam_init.types.result import Result

if TYPE_CHECKING:
    from slam_init.datasets import TimedSource
    from slam_init.datasets.points import PointSource
    from slam_init.types.camera import Camera

__all__ = ["COLUMNS", "Settings", "Trial", "error_row", "file_name", "recording_folder", "run_trial"]

#: Slower than this a sequence is a set of photographs, for which seconds mean nothing.
_LEAST_VIDEO_FPS = 5.0
#: Of an error's text, in characters; and of a folder's name, which may hold 255 bytes.
_LONGEST_CAUSE, _LONGEST_NAME = 200, 120

#: Columns of ``results.csv``. Only those that end in ``_ms`` or ``_mb`` differ from run to run.
#: ``kept_truth`` says of a run that ended with ``ambiguous_plane`` whether one of the maps that it kept is correct;
#: ``suspected_focal_factor`` is the focal length over the stated one of the checks that suspect it (their median), and
#: ``reported_focal_factor`` what the result tells the user, who is told once several checks agree.
COLUMNS: tuple[str, ...] = (
    "source", "method", "start", "outcome", "reason", "frames_to_accept", "rotation_error_deg", "direction_error_deg",
    "group", "strict", "frames_limit", "seconds_to_accept", "ate", "rotation_error_before_deg",
    "direction_error_before_deg", "ate_before", "survival", "depth_error", "depth_order_error", "landmarks",
    "keyframes", "parallax_deg", "reprojection_rmse_px", "attempts", "injected_cause", "reason_right", "kept_truth",
    "suspected_focal_factor", "reported_focal_factor",
    "frame_median_ms", "frame_p95_ms", "attempt_median_ms", "trial_ms", "peak_memory_mb",
)  # fmt: skip


@dataclass(frozen=True)
class Trial:
    """A method on a source from a start."""

    source: ComparedSource
    method: str
    start: int

    @property
    def key(self) -> tuple[str, str, int]:
        """What the rows are sorted by."""
        return self.source.label, self.method, self.start


@dataclass(frozen=True)
class Settings:
    """What all trials of a comparison have in common.

    Attributes
    ----------
    seed : int
        Of the methods' random draws.
    limit_frames : int
        A trial ends after so many frames ...
    limit_s : float
        ... or after so many seconds of video.
    tracks : str
        Folder of the stored tracks.
    recordings : str or None
        Folder of the recordings, where they are wanted.
    time_limit_s : float
        A trial that takes longer is stopped and counts as an error.
    memory_limit_mb : int
        Likewise one that takes more memory.
    config : Config
        Options of the methods; their ``method`` and ``seed`` are not used.
    """

    seed: int = 0
    limit_frames: int = 150
    limit_s: float = 5.0
    tracks: str = ""
    recordings: str | None = None
    time_limit_s: float = 300.0
    memory_limit_mb: int = 6000
    config: Config = field(default_factory=Config)

    def frames_limit(self, source: ComparedSource, start: int) -> int:
        """How many frames a trial may read."""
        limit = min(self.limit_frames, source.frames - start)
        video = source.fps >= _LEAST_VIDEO_FPS
        return min(limit, max(2, round(self.limit_s * source.fps))) if video else limit


def run_trial(trial: Trial, settings: Settings) -> dict[str, Any]:
    """Run a trial and measure what came of it.

    Returns
    -------
    dict
        The columns of :data:`COLUMNS` but ``peak_memory_mb``.

    Raises
    ------
    SlamInitError
        Where the source cannot be read. What a method raises is raised as well.
    """
    from slam_init.methods import make_initializer

    begin = time.perf_counter()
    source = _opened(trial.source.text)
    camera = calibration_of(source, trial.source.text)
    steps = replay(source, trial.source.text, trial.start, Path(settings.tracks))
    limit = settings.frames_limit(trial.source, trial.start)
    pictures = source.frames(trial.start, limit) if settings.recordings is not None else None
    frames_ms: list[float] = []
    attempts_ms: list[float] = []
    with _recorder(trial, settings, source, camera) as recorder:
        initializer = make_initializer(trial.method, camera, replace(settings.config, seed=settings.seed), recorder)
        for _, step in zip(range(limit), steps, strict=False):
            if pictures is not None:
                recorder.frame(next(pictures), step.current)
            fed = time.perf_counter()
            status = initializer.process_tracks(step.current, step.revised)
            frames_ms.append(1e3 * (time.perf_counter() - fed))
            if status.attempt is not None:
                attempts_ms.append(frames_ms[-1])
            if status:
                break
        result = initializer.finish()
        row = _row(trial, settings, result, source, camera, steps)
        if settings.recordings is not None:
            _record_end(trial, settings, result, source, camera, recorder)
    return row | {
        "frame_median_ms": _quantile(frames_ms, 0.5),
        "frame_p95_ms": _quantile(frames_ms, 0.95),
        "attempt_median_ms": _quantile(attempts_ms, 0.5),
        "trial_ms": _rounded(1e3 * (time.perf_counter() - begin)),
    }


def error_row(trial: Trial, settings: Settings, cause: str) -> dict[str, Any]:
    """The row of a trial that the method did not survive."""
    return _blank(trial, settings) | {"outcome": "error", "reason": " ".join(cause.split())[:_LONGEST_CAUSE]}


def recording_folder(recordings: str, source: str, start: int) -> Path:
    """Folder of the recordings of one start."""
    return Path(recordings) / f"{quote(source, safe='').replace('%', '_')[-_LONGEST_NAME:]}-{start:06d}"


@lru_cache(maxsize=1)
def _opened(text: str) -> TimedSource | PointSource:
    """The last source is kept: its next trial comes next, and a synthetic world takes a second to build."""
    return open_compared(text)


# -- rows ------------------------------------------------------------------------------------------


def _blank(trial: Trial, settings: Settings) -> dict[str, Any]:
    """What is known of a trial before it ran."""
    return dict.fromkeys(COLUMNS) | {
        "source": trial.source.label,
        "method": trial.method,
        "start": trial.start,
        "group": trial.source.group,
        "frames_limit": settings.frames_limit(trial.source, trial.start),
        "injected_cause": judging_of(trial.source.group).cause,
    }


def _row(
    trial: Trial,
    settings: Settings,
    result: Result,
    source: TimedSource | PointSource,
    camera: Camera,
    following: Iterator[Step],
) -> dict[str, Any]:
    judging = judging_of(trial.source.group)
    row = _blank(trial, settings) | {
        "attempts": len(result.attempts),
        "strict": False,
        "suspected_focal_factor": _rounded(_suspected_focal_factor(result)),
        "reported_focal_factor": _rounded(reported_focal_factor(result.attempts)),
    }
    if result.map is None:
        right = result.reason == judging.cause if judging.cause is not None else None
        kept = _kept_truth(result, source, judging)
        return row | {"outcome": "none", "reason": result.reason, "reason_right": right, "kept_truth": kept}
    row |= {
        "outcome": _outcome(result.map, source, judging),
        "frames_to_accept": result.frames_to_init,
        "seconds_to_accept": _rounded(_seconds(source, trial.start, result)),
        "landmarks": len(result.map.points),
        "keyframes": " ".join(str(keyframe.frame) for keyframe in result.map.keyframes),
        "parallax_deg": _rounded(result.map.median_parallax_deg),
        "reprojection_rmse_px": _rounded(result.map.reprojection_rmse_px),
        "survival": _rounded(survival(result.map, following)),
    }
    if judging.cause is not None:
        row["reason_right"] = False  # a map where there should be a reason
    if source.groundtruth is not None:
        after = pose_errors(result.map, source.groundtruth)
        before = pose_errors(result.map, source.groundtruth, before=True)
        row |= {
            "strict": is_strict(after, judging),
            "rotation_error_deg": _rounded(after.rotation_deg),
            "direction_error_deg": _rounded(after.direction_deg if judging.direction_known else None),
            "ate": _rounded(after.ate),
            "rotation_error_before_deg": _rounded(before.rotation_deg),
            "direction_error_before_deg": _rounded(before.direction_deg if judging.direction_known else None),
            "ate_before": _rounded(before.ate),
        }
    depths = depth_errors(result.map, source)
    return row | {"depth_error": _rounded(depths.relative), "depth_order_error": _rounded(depths.wrong_order)}


def _outcome(map_: InitialMap, source: TimedSource | PointSource, judging: Judging) -> str:
    """``correct`` or ``false``; ``accepted`` where nothing is known to judge by."""
    if source.groundtruth is None and not judging.still:
        return ACCEPTED
    return "correct" if is_correct(pose_errors(map_, source.groundtruth), judging) else "false"


def _kept_truth(result: Result, source: TimedSource | PointSource, judging: Judging) -> bool | None:
    """Of an undecided plane: whether one of the kept maps is correct; None where there is no truth to judge by."""
    if result.reason != "ambiguous_plane" or (source.groundtruth is None and not judging.still):
        return None
    return any(_outcome(map_, source, judging) == "correct" for map_ in result.hypotheses)


def _suspected_focal_factor(result: Result) -> float | None:
    """Median of the attempts that suspect one."""
    factors = [a.evidence["suspected_focal_factor"] for a in result.attempts if "suspected_focal_factor" in a.evidence]
    return float(np.median(np.array(factors, float))) if factors else None


def _seconds(source: TimedSource | PointSource, start: int, result: Result) -> float | None:
    """Of video, from the first frame fed to the one that the map was accepted at."""
    last = start + (result.frames_to_init or 1) - 1
    return float(source.timestamps_s[last] - source.timestamps_s[start])


def _quantile(values: list[float], q: float) -> float | None:
    return _rounded(float(np.quantile(values, q))) if values else None


def _rounded(value: float | None) -> float | None:
    """Six significant digits: what is printed is what is compared."""
    return None if value is None else float(f"{value:.6g}")


# -- recordings ------------------------------------------------------------------------------------


def _recorder(trial: Trial, settings: Settings, source: TimedSource | PointSource, camera: Camera) -> Recorder:
    if settings.recordings is None:
        return Recorder()
    from slam_init.recording.recorder import RerunRecorder

    folder = recording_folder(settings.recordings, trial.source.label, trial.start)
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{trial.source.label} {trial.method} {trial.start}"
    path = folder / f"{file_name(trial.method)}.rrd"
    return RerunRecorder(path, camera, name, source.groundtruth, settings.seed)


def file_name(method: str) -> str:
    """A method's name, which may be ``package.module:attribute``, as part of a file's name."""
    return quote(method, safe="").replace("%3A", "-")


def _record_end(
    trial: Trial,
    settings: Settings,
    result: Result,
    source: TimedSource | PointSource,
    camera: Camera,
    recorder: Recorder,
) -> None:
    """Finish the trial's recording, and keep the map for the one that shows the methods side by side."""
    from slam_init.compare.map_snapshot import keep_result
    from slam_init.evaluation.metrics import compare_with_groundtruth
    from slam_init.output.results import summary_dict

    truth = compare_with_groundtruth(result.map.keyframes, source.groundtruth) if result.map is not None else None
    recorder.summary(summary_dict(result, source, camera, trial.method, settings.seed, truth))
    folder = recording_folder(str(settings.recordings), trial.source.label, trial.start)
    keep_result(folder / f"{file_name(trial.method)}.npz", result, trial.start, source.groundtruth)
