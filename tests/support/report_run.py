"""Reports of a whole run to a recorder."""

from __future__ import annotations

from dataclasses import replace

from make_map import make_attempts, make_frame, make_map, make_observations, make_poses, make_result
from make_summary import summarize

from slam_init.recording.recorder import Recorder
from slam_init.recording.rerun_recorder import RerunRecorder
from slam_init.types.initial_map import InitialMap, Keyframe


def report_run(recorder: Recorder, model: str = "pinhole", color: bool = True) -> InitialMap:
    """Report a whole run to a recorder: frames, attempts, a map, a frame after it, a summary."""
    map_ = make_map(model)
    observations = make_observations(map_, model)
    attempts = make_attempts(map_)
    for i, seen in enumerate(observations):
        recorder.frame(make_frame(seen.frame, seen.timestamp_s, seen.name, color), seen)
        if i > 0:
            recorder.attempt(attempts[i - 1])
        if seen is observations[-1]:
            recorder.initialized(map_, observations)
    later = replace(observations[-1], frame=32, timestamp_s=observations[-1].timestamp_s + 1 / 30)
    recorder.frame(make_frame(32, later.timestamp_s, later.name, color), later)
    recorder.continued(Keyframe(32, later.timestamp_s, later.name, make_poses(5)[4]))
    if isinstance(recorder, RerunRecorder):
        recorder.summary(summarize(make_result(map_)))
    recorder.close()
    return map_
