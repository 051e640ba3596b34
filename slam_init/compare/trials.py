"""One trial: feeds a method with the tracks of a sequence from a start frame, until its first map or the limit."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slam_init.compare.judging import Criteria, Truth
from slam_init.compare.measures import depth_errors, is_correct, is_strict, pose_errors, survival
from slam_init.compare.recordings import TrialRecording
from slam_init.compare.replay import Step, replay
from slam_init.compare.rows import Key, Outcome, TrialRow
from slam_init.compare.sources import ComparedSource, calibration_of, open_compared
from slam_init.compare.trajectories import write_trajectory
from slam_init.config import Config, ExternalConfig
from slam_init.decision.attempt_log import reported_distortion
from slam_init.decision.audit import audit
from slam_init.errors import SlamInitError
from slam_init.methods.external_command import is_external
from slam_init.types.frame import Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.reasons import Verdict
from slam_init.types.result import Result

if TYPE_CHECKING:
    from slam_init.datasets import TimedSource
    from slam_init.datasets.points import PointSource
    from slam_init.recording.recorder import Recorder
    from slam_init.types.camera import Camera
    from slam_init.types.pose import Trajectory

#: A sequence with fewer frames per second is a set of photographs. The limit in seconds is not applied to it.
_MIN_VIDEO_FPS = 5.0
#: Largest length of an error message in characters.
_MAX_CAUSE = 200


@dataclass(frozen=True)
class Trial:
    """A method on a source from a start frame."""

    source: ComparedSource
    method: str
    start: int

    @property
    def key(self) -> Key:
        """Sort key of the rows."""
        return self.source.label, self.method, self.start


@dataclass(frozen=True)
class Settings:
    """Settings that all trials of a comparison share."""

    #: Seed of the random draws of the methods.
    seed: int = 0
    #: A trial ends after this number of frames.
    limit_frames: int = 150
    #: A trial on a video also ends after this number of seconds of video.
    limit_s: float = 5.0
    #: Folder of the stored tracks.
    tracks: str = ""
    #: Folder of the recordings; None if no recordings are written.
    recordings: str | None = None
    #: Folder of the trajectories; None if none are written.
    trajectories: str | None = None
    #: A trial that takes longer is stopped and counts as an error.
    time_limit_s: float = 300.0
    #: A trial that allocates more memory counts as an error. 0 for no limit.
    memory_limit_mb: int = 6000
    #: Whether the maps are audited.
    audit: bool = False
    #: Options of the methods; the fields ``method`` and ``seed`` are not used.
    config: Config = field(default_factory=Config)

    def frames_limit(self, source: ComparedSource, start: int) -> int:
        """Return the number of frames that a trial may read.

        * Returns: At most :attr:`limit_frames` and the frames that are left. For a video also at most :attr:`limit_s`
          seconds, but at least two frames.
        """
        limit = min(self.limit_frames, source.frames - start)
        video = source.fps >= _MIN_VIDEO_FPS
        return min(limit, max(2, round(self.limit_s * source.fps))) if video else limit


def run_trial(trial: Trial, settings: Settings) -> TrialRow:
    """Run a trial and measure its result."""
    begin = time.perf_counter()
    source = _opened(trial.source.text)
    camera = calibration_of(source, trial.source.text)
    recording = TrialRecording(settings.recordings, trial.source.label, trial.method, trial.start, settings.seed)
    run = _run_program if is_external(trial.method) else _run_method
    with recording.recorder(source, camera) as recorder:
        result, following, times_ms = run(trial, settings, source, camera, recorder)
        row = result_row(trial, settings, result, source, following)
        recording.end(result, source, camera, recorder)
    times_ms["trial_ms"] = 1e3 * (time.perf_counter() - begin)
    columns: dict[str, Any] = {name: _rounded(value) for name, value in times_ms.items()}
    if settings.audit and result.map is not None:
        columns["audited_risk"] = _rounded(_audited_risk(trial, settings, result.map, source, camera))
    return replace(row, **columns)


def _run_method(
    trial: Trial, settings: Settings, source: TimedSource | PointSource, camera: Camera, recorder: Recorder
) -> tuple[Result, Iterable[Step], dict[str, Any]]:
    """Feed a method; return its result, the tracks of the frames that follow, and the columns of its times."""
    from slam_init.methods import make_initializer

    steps = replay(source, trial.source.text, trial.start, Path(settings.tracks))
    limit = settings.frames_limit(trial.source, trial.start)
    pictures = source.frames(trial.start, limit) if settings.recordings is not None else None
    frames_ms: list[float] = []
    attempts_ms: list[float] = []
    initializer = make_initializer(trial.method, camera, replace(settings.config, seed=settings.seed), recorder)
    for _, step in zip(range(limit), steps, strict=False):
        if pictures is not None:
            recorder.frame(next(pictures), step.current)
        fed = time.perf_counter()
        status = initializer.process_tracks(step.current, revised=step.revised)
        frames_ms.append(1e3 * (time.perf_counter() - fed))
        if status.attempt is not None:
            attempts_ms.append(frames_ms[-1])
        if status:
            break
    columns = {"frame_median_ms": (frames_ms, 0.5), "frame_p95_ms": (frames_ms, 0.95)}
    columns["attempt_median_ms"] = (attempts_ms, 0.5)
    times_ms = {name: float(np.quantile(values, q)) if values else None for name, (values, q) in columns.items()}
    return initializer.finish(), steps, times_ms


def _run_program(
    trial: Trial, settings: Settings, source: TimedSource | PointSource, camera: Camera, recorder: Recorder
) -> tuple[Result, Iterable[Step], dict[str, Any]]:
    """Run an external program, which gets images. The time of a frame is its share of the program's time."""
    from slam_init.methods.external import ExternalInitializer

    limit = settings.frames_limit(trial.source, trial.start)
    limits = ExternalConfig(settings.time_limit_s, settings.memory_limit_mb, max(limit, 2))
    config = replace(settings.config, seed=settings.seed, external=limits)
    scratch = settings.tracks if settings.tracks and Path(settings.tracks).is_dir() else None
    initializer = ExternalInitializer(trial.method, camera, config, recorder, scratch)
    try:
        for frame in source.frames(trial.start, limit):
            initializer.process(frame)
        result = initializer.finish()
    finally:
        initializer.close()
    program = initializer.program
    frame_ms = None if program is None else 1e3 * program.seconds / initializer.frames_read
    return result, (), {"frame_median_ms": frame_ms, "frame_p95_ms": frame_ms}


def error_row(trial: Trial, settings: Settings, cause: str) -> TrialRow:
    """Return the row of a trial that ended in an error.

    * ``cause``: Message of the error. Line breaks are removed, and the text is cut after 200 characters.
    """
    return replace(_blank(trial, settings, "error"), reason=" ".join(cause.split())[:_MAX_CAUSE])


@lru_cache(maxsize=1)
def _opened(text: str) -> TimedSource | PointSource:
    """Open and cache a source: its trials follow one another, and a synthetic world takes a second to build."""
    return open_compared(text)


def _audited_risk(
    trial: Trial, settings: Settings, map_: InitialMap, source: TimedSource | PointSource, camera: Camera
) -> float | None:
    """Audit the poses of a map with all tracks that the trial could read; None where they do not connect its frames."""
    limit, views = settings.frames_limit(trial.source, trial.start), dict[int, Observations]()
    steps = replay(source, trial.source.text, trial.start, Path(settings.tracks))
    for _, step in zip(range(limit), steps, strict=False):
        views |= {view.frame: view for view in (*step.revised, step.current)}
    poses = {keyframe.frame: keyframe.world_from_cam for keyframe in map_.keyframes}
    try:
        return audit(poses, views.values(), camera, settings.config).risk
    except SlamInitError:
        return None


# -- rows ------------------------------------------------------------------------------------------


def _blank(trial: Trial, settings: Settings, outcome: Outcome) -> TrialRow:
    """Return the row of a trial with its outcome and the values that are known before the trial runs."""
    return TrialRow(
        source=trial.source.label,
        method=trial.method,
        start=trial.start,
        outcome=outcome,
        group=trial.source.group,
        frames_limit=settings.frames_limit(trial.source, trial.start),
        injected_cause=trial.source.criteria.expected_reason,
        judged_by=trial.source.criteria.rule,
    )


def result_row(
    trial: Trial, settings: Settings, result: Result, source: TimedSource | PointSource, following: Iterable[Step]
) -> TrialRow:
    """Return the row of a trial that ended with a result; times and memory are None.

    * ``following``: Tracks of the frames after the last one that the method read. ``survival`` is measured on them.
    """
    criteria = trial.source.criteria
    expected = criteria.expected_reason
    outcome: Outcome = "none" if result.map is None else _outcome(result.map, source, criteria)
    row = replace(
        _blank(trial, settings, outcome),
        attempts=len(result.attempts),
        strict=False,
        suspected_focal_factor=_rounded(_suspected_focal_factor(result)),
        reported_focal_factor=_rounded(None if result.wrong_focal is None else result.wrong_focal.factor),
        reported_distortion=_rounded(reported_distortion(result.attempts)),
    )
    if result.map is None:
        return replace(
            row,
            reason=None if result.reason is None else str(result.reason),
            reason_right=result.reason == expected if expected is not None else None,
            kept_truth=_kept_truth(result, source, criteria),
        )
    if settings.trajectories is not None:
        keyframes = result.map.keyframes
        write_trajectory(
            settings.trajectories, trial.method, trial.source.label, trial.start, keyframes, source.groundtruth
        )
    row = replace(
        row,
        frames_to_accept=result.frames_to_init,
        seconds_to_accept=_rounded(_seconds(source, trial.start, result)),
        landmarks=len(result.map.points) or None,  # an external program gives none
        keyframes=" ".join(str(keyframe.frame) for keyframe in result.map.keyframes),
        parallax_deg=_finite(result.map.median_parallax_deg),
        reprojection_rmse_px=_finite(result.map.reprojection_rmse_px),
        survival=_rounded(survival(result.map, following)) if len(result.map.points) else None,
        # The method accepted a map instead of giving the expected reason.
        reason_right=False if expected is not None else None,
    )
    if source.groundtruth is not None:
        row = _with_pose_errors(row, result.map, source.groundtruth, criteria)
    row = _with_stated_risk(row, result, source.groundtruth, criteria)
    if not len(result.map.points):  # an external program gives no landmarks
        return row
    depths = depth_errors(result.map, source)
    return replace(row, depth_error=_rounded(depths.relative), depth_order_error=_rounded(depths.wrong_order))


def _with_pose_errors(row: TrialRow, map_: InitialMap, truth: Trajectory, criteria: Criteria) -> TrialRow:
    """Return the row with the errors of the poses, before and after bundle adjustment."""
    after = pose_errors(map_, truth)
    before = pose_errors(map_, truth, before=True)
    return replace(
        row,
        strict=is_strict(after, criteria),
        rotation_error_deg=_rounded(after.rotation_deg),
        direction_error_deg=_rounded(after.direction_deg if criteria.direction_deg is not None else None),
        ate=_rounded(after.ate),
        rotation_error_before_deg=_rounded(before.rotation_deg),
        direction_error_before_deg=_rounded(before.direction_deg if criteria.direction_deg is not None else None),
        ate_before=_rounded(before.ate),
    )


def _with_stated_risk(row: TrialRow, result: Result, truth: Trajectory | None, criteria: Criteria) -> TrialRow:
    """Return the row with the risk and the standard deviations that the accepted attempt states, if any."""
    accepted = next((one for one in reversed(result.attempts) if one.verdict == Verdict.ACCEPTED), None)
    if result.map is None or accepted is None or accepted.window is None:
        return row
    pair = pose_errors(result.map, truth, frames=accepted.frames[:2])
    return replace(
        row,
        risk=_rounded(accepted.window.risk),
        rotation_sigma_deg=_finite(accepted.window.rotation_sigma_deg),
        direction_sigma_deg=_finite(accepted.window.direction_sigma_deg),
        pair_rotation_error_deg=_rounded(pair.rotation_deg),
        pair_direction_error_deg=_rounded(pair.direction_deg if criteria.direction_deg is not None else None),
    )


def _outcome(map_: InitialMap, source: TimedSource | PointSource, criteria: Criteria) -> Outcome:
    """Return ``correct`` or ``false``; ``accepted`` if there is no ground truth to compare the map with."""
    if criteria.truth is Truth.NONE:
        return "accepted"
    return "correct" if is_correct(pose_errors(map_, source.groundtruth), criteria) else "false"


def _kept_truth(result: Result, source: TimedSource | PointSource, criteria: Criteria) -> bool | None:
    """Return whether one of the hypotheses of an ambiguous plane is correct; None if that cannot be said."""
    if result.reason != "ambiguous_plane" or criteria.truth is Truth.NONE:
        return None
    return any(_outcome(map_, source, criteria) == "correct" for map_ in result.hypotheses)


def _suspected_focal_factor(result: Result) -> float | None:
    """Return the median over the attempts that suspect a wrong focal length; None if no attempt does."""
    factors = [a.suspected_focal_factor for a in result.attempts if a.suspected_focal_factor is not None]
    return float(np.median(np.array(factors, float))) if factors else None


def _seconds(source: TimedSource | PointSource, start: int, result: Result) -> float | None:
    """Return the seconds of video from the first frame of the trial to the frame at which the map was accepted."""
    last = start + (result.frames_to_init or 1) - 1
    return float(source.timestamps_s[last] - source.timestamps_s[start])


def _rounded(value: float | None) -> float | None:
    """Round to six significant digits, so that the files hold exactly the values that the figures are made of."""
    return None if value is None else float(f"{value:.6g}")


def _finite(value: float) -> float | None:
    """Round a stated figure. A row holds finite numbers only."""
    return _rounded(value) if math.isfinite(value) else None
