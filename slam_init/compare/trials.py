"""One trial: feeds a method with the tracks of a sequence from a start frame, until its first map or the limit."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from slam_init.compare.criteria import Criteria, Truth
from slam_init.compare.measures import PoseErrors, depth_errors, is_correct, is_strict, pose_errors, survival
from slam_init.compare.replay import Step, replay
from slam_init.compare.rows import Key, Outcome, TrialRow
from slam_init.compare.sources import AnySource, ComparedSource, calibration_of, open_compared
from slam_init.config import Config, ExternalConfig
from slam_init.datasets.synth import POINTS
from slam_init.decision.attempt_log import reported_distortion
from slam_init.errors import SlamInitError
from slam_init.methods.external_command import is_external
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Trajectory
from slam_init.types.refusal import Verdict
from slam_init.types.result import Result

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
    #: A trial that takes longer is stopped and counts as an error.
    time_limit_s: float = 300.0
    #: A trial that allocates more memory counts as an error. 0 for no limit.
    memory_limit_mb: int = 6000
    #: Whether the maps are audited.
    audit: bool = False

    def frames_limit(self, source: ComparedSource, start: int) -> int:
        """Return the number of frames that a trial may read.

        * Returns: At most :attr:`limit_frames` and the frames that are left. For a video also at most :attr:`limit_s`
          seconds, but at least two frames.
        """
        limit = min(self.limit_frames, source.frames - start)
        video = source.fps >= _MIN_VIDEO_FPS
        return min(limit, max(2, round(self.limit_s * source.fps))) if video else limit


@dataclass(frozen=True)
class Plan:
    """The sources and methods of a comparison; its trials are all combinations of source, start frame and method."""

    sources: tuple[ComparedSource, ...]
    #: Names as in ``slam-init run --method``.
    methods: tuple[str, ...]
    #: Step between two start frames.
    every: int = 10
    #: Smallest number of frames that a trial can read, with the start frame. Two views and a third one that confirms
    #: them are the least from which every method can make a map.
    min_left: int = 3
    #: The folder in it is not used: :func:`slam_init.compare.run.compare` chooses it.
    settings: Settings = field(default_factory=Settings)

    def trials(self) -> Iterator[Trial]:
        """Yield all trials. The trials of one source follow one another, so that a process opens the source once."""
        for source in self.sources:
            for start in self.starts(source):
                for method in self.methods_on(source):
                    yield Trial(source, method, start)

    def methods_on(self, source: ComparedSource) -> tuple[str, ...]:
        """Return the methods that can run on a source. External programs need images."""
        if not source.group.startswith(POINTS):
            return self.methods
        return tuple(method for method in self.methods if not is_external(method))

    def starts(self, source: ComparedSource) -> range:
        """Return the start frames of the trials on a source.

        * Returns: Every :attr:`every`-th frame that leaves :attr:`min_left` frames. A shorter sequence has one start,
          frame 0.
        """
        return range(0, max(source.frames - self.min_left + 1, 1), self.every)


def run_trial(trial: Trial, settings: Settings) -> TrialRow:
    """Run a trial and measure its result."""
    begin = time.perf_counter()
    source = _opened(trial.source.text)
    camera = calibration_of(source, trial.source.text)
    result, following, times_ms = _result(trial, settings, source, camera)
    row = result_row(trial, settings, result, source, following)
    columns = {**times_ms, "trial_ms": 1e3 * (time.perf_counter() - begin)}
    if settings.audit and result.map is not None:
        columns["audited_risk"] = _audited_risk(trial, settings, result.map, source, camera)
    rounded: dict[str, Any] = {name: _rounded(value) for name, value in columns.items()}
    return replace(row, **rounded)


def _result(
    trial: Trial, settings: Settings, source: AnySource, camera: Camera
) -> tuple[Result, Iterable[Step], dict[str, float | None]]:
    """Feed a method; return its result, the tracks of the frames that follow, and the columns of its times.

    An external program gets images. The time of a frame is then its share of the whole.
    """
    from slam_init.methods import make_initializer

    limit, begin = settings.frames_limit(trial.source, trial.start), time.perf_counter()
    limits = ExternalConfig(settings.time_limit_s, settings.memory_limit_mb, max(limit, 2))
    initializer = make_initializer(trial.method, camera, Config(seed=settings.seed, external=limits))
    if is_external(trial.method):
        for frame in source.frames(trial.start, limit):
            initializer.process(frame)
        result = initializer.finish()
        frame_ms = 1e3 * (time.perf_counter() - begin) / limit
        return result, (), {"frame_median_ms": frame_ms, "frame_p95_ms": frame_ms}
    steps = replay(source, trial.source.text, trial.start, settings.tracks)
    frames_ms: list[float] = []
    attempts_ms: list[float] = []
    for _, step in zip(range(limit), steps, strict=False):
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


def error_row(trial: Trial, settings: Settings, cause: str) -> TrialRow:
    """Return the row of a trial that ended in an error.

    * ``cause``: Message of the error. Line breaks are removed, and the text is cut after 200 characters.
    """
    return _row(trial, settings, "error", reason=" ".join(cause.split())[:_MAX_CAUSE])


@lru_cache(maxsize=1)
def _opened(text: str) -> AnySource:
    """Open and cache a source: its trials follow one another, and a synthetic world takes a second to build."""
    return open_compared(text)


def _audited_risk(
    trial: Trial, settings: Settings, map_: InitialMap, source: AnySource, camera: Camera
) -> float | None:
    """Audit the poses of a map with all tracks that the trial could read; None where they do not connect its frames."""
    from slam_init import audit

    limit, views = settings.frames_limit(trial.source, trial.start), dict[int, Observations]()
    steps = replay(source, trial.source.text, trial.start, settings.tracks)
    for _, step in zip(range(limit), steps, strict=False):
        views |= {view.frame: view for view in (*step.revised, step.current)}
    poses = {keyframe.frame: keyframe.world_from_cam for keyframe in map_.keyframes}
    try:
        return audit(poses, views.values(), camera).model_risk
    except SlamInitError:
        return None


# -- rows ------------------------------------------------------------------------------------------


def result_row(
    trial: Trial, settings: Settings, result: Result, source: AnySource, following: Iterable[Step]
) -> TrialRow:
    """Return the row of a trial that ended with a result; times and memory are None.

    * ``following``: Tracks of the frames after the last one that the method read. ``survival`` is measured on them.
    """
    criteria, map_, truth = trial.source.criteria, result.map, source.groundtruth
    expected = criteria.expected_reason
    suspected = [a.suspected_focal_factor for a in result.attempts if a.suspected_focal_factor is not None]
    columns: dict[str, Any] = {
        "strict": map_ is not None and is_strict(pose_errors(map_, truth), criteria),
        "attempts": len(result.attempts),
        "suspected_focal_factor": float(np.median(suspected)) if suspected else None,
        "reported_focal_factor": None if result.wrong_focal is None else result.wrong_focal.factor,
        "reported_distortion": reported_distortion(result.attempts),
        # A method that accepts a map does not give the expected reason.
        "reason_right": None if expected is None else map_ is None and result.reason == expected,
    }
    if map_ is None:
        reason = None if result.reason is None else str(result.reason)
        kept = None
        if reason == Verdict.AMBIGUOUS_PLANE and criteria.truth is not Truth.NONE:
            kept = any(_outcome(one, truth, criteria) == "correct" for one in result.hypotheses)
        return _row(trial, settings, "none", **columns, reason=reason, kept_truth=kept)
    last = trial.start + (result.frames_to_init or 1) - 1
    columns |= {
        "frames_to_accept": result.frames_to_init,
        "seconds_to_accept": float(source.timestamps_s[last] - source.timestamps_s[trial.start]),
        "keyframes": " ".join(str(keyframe.frame) for keyframe in map_.keyframes),
        "parallax_deg": map_.median_parallax_deg,
        "reprojection_rmse_px": map_.reprojection_rmse_px,
        **_error_columns(map_, truth, criteria),
        **_stated_columns(result, map_, truth, criteria),
    }
    if len(map_.points):  # an external program gives no landmarks
        columns |= {"landmarks": len(map_.points), "survival": survival(map_, following)}
        columns["depth_error"], columns["depth_order_error"] = depth_errors(map_, source)
    return _row(trial, settings, _outcome(map_, truth, criteria), **columns)


def _row(trial: Trial, settings: Settings, outcome: Outcome, **columns: Any) -> TrialRow:
    """Return a row with the values that are known before the trial runs, and others.

    Numbers have six significant digits, so that the files hold exactly the values that the figures are made of.
    """
    source, criteria = trial.source, trial.source.criteria
    known: dict[str, Any] = {
        "source": source.label,
        "method": trial.method,
        "start": trial.start,
        "group": source.group,
    }
    known |= {"injected_cause": criteria.expected_reason, "evaluated_by": criteria.rule}
    known |= {name: _rounded(value) if isinstance(value, float) else value for name, value in columns.items()}
    return TrialRow(outcome=outcome, frames_limit=settings.frames_limit(source, trial.start), **known)


def _error_columns(map_: InitialMap, truth: Trajectory | None, criteria: Criteria) -> dict[str, float | None]:
    """The errors of the poses, before and after bundle adjustment."""
    columns = {}
    for suffix, early in (("", False), ("_before", True)):
        errors = _evaluated(pose_errors(map_, truth, before=early), criteria)
        columns[f"rotation_error{suffix}_deg"] = errors.rotation_deg
        columns[f"direction_error{suffix}_deg"] = errors.direction_deg
        columns[f"ate{suffix}"] = errors.ate
    return columns


def _stated_columns(
    result: Result, map_: InitialMap, truth: Trajectory | None, criteria: Criteria
) -> dict[str, float | None]:
    """The risk and the standard deviations that the accepted attempt states, if any, and the errors of its pair."""
    accepted = next((one for one in reversed(result.attempts) if one.verdict == Verdict.ACCEPTED), None)
    if accepted is None or (window := accepted.window) is None:
        return {}
    pair = _evaluated(pose_errors(map_, truth, frames=accepted.frames[:2]), criteria)
    stated = {"rotation_sigma_deg": window.rotation_sigma_deg, "direction_sigma_deg": window.direction_sigma_deg}
    errors = {"pair_rotation_error_deg": pair.rotation_deg, "pair_direction_error_deg": pair.direction_deg}
    return {"risk": window.risk, **stated, **errors}


def _evaluated(errors: PoseErrors, criteria: Criteria) -> PoseErrors:
    """Leave out the direction where it is not evaluated."""
    return errors if criteria.direction_deg is not None else replace(errors, direction_deg=None)


def _outcome(map_: InitialMap, truth: Trajectory | None, criteria: Criteria) -> Outcome:
    """Return ``correct`` or ``false``; ``accepted`` if there is no ground truth to compare the map with."""
    if criteria.truth is Truth.NONE:
        return "accepted"
    return "correct" if is_correct(pose_errors(map_, truth), criteria) else "false"


def _rounded(value: float | None) -> float | None:
    """Round to six significant digits; a row holds finite numbers only."""
    return float(f"{value:.6g}") if value is not None and math.isfinite(value) else None
