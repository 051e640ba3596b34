"""The recordings of a comparison: their names, the recording of one trial, and the snapshot of its map."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np

from slam_init.evaluation.metrics import compare_with_groundtruth, true_path
from slam_init.methods.external_command import method_label
from slam_init.output.folder import output_error
from slam_init.output.names import UNFINISHED, folder_name
from slam_init.recording.recorder import Recorder
from slam_init.types.arrays import Floats, Image
from slam_init.types.pose import Trajectory
from slam_init.types.result import Result

if TYPE_CHECKING:
    from slam_init.datasets import TimedSource
    from slam_init.datasets.points import PointSource
    from slam_init.types.camera import Camera

#: The folder of the recordings in that of the results.
RECORDINGS = "recordings"
#: The recording of all methods from one start.
SIDE_BY_SIDE = "side-by-side.rrd"


def recording_folder(recordings: str | os.PathLike[str], source: str, start: int) -> Path:
    """Return the folder of the recordings of one start."""
    return Path(recordings) / f"{folder_name(source)}-{start:06d}"


def recording_name(method: str) -> str:
    """Return the name of the recording of a trial in its folder.

    * Returns: The colon becomes a hyphen; other special characters become percent codes.
    """
    return f"{_file_name(method)}.rrd"


def snapshot_name(method: str) -> str:
    """Return the name of the snapshot of the map of a trial, beside its recording."""
    return f"{_file_name(method)}.npz"


def names_of_start(source: str, start: int, methods: Iterable[str]) -> Iterator[str]:
    """Return all files that the trials of one start may write."""
    folder = recording_folder(RECORDINGS, source, start)
    for name in (
        SIDE_BY_SIDE,
        *(name for method in methods for name in (recording_name(method), snapshot_name(method))),
    ):
        yield (folder / name).as_posix()
        if name.endswith(".rrd"):  # its name until it is complete
            yield (folder / name).with_suffix(UNFINISHED).as_posix()


def _file_name(method: str) -> str:
    return quote(method_label(method), safe="").replace("%3A", "-")


@dataclass(frozen=True)
class TrialRecording:
    """Where and under which name a trial is recorded."""

    #: Folder of all recordings; None if none are written.
    folder: str | None
    #: Label of the source.
    label: str
    method: str
    #: Start frame.
    start: int
    seed: int

    def recorder(self, source: TimedSource | PointSource, camera: Camera) -> Recorder:
        """Make the recorder of the trial."""
        if self.folder is None:
            return Recorder()
        from slam_init.recording.rerun_recorder import RerunRecorder

        folder = self._home()
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise output_error(folder, error) from error
        name = f"{self.label} {self.method} {self.start}"
        return RerunRecorder(folder / recording_name(self.method), camera, name, source.groundtruth, self.seed)

    def end(self, result: Result, source: TimedSource | PointSource, camera: Camera, recorder: Recorder) -> None:
        """Finish the recording, and store a snapshot of the map. Nothing is done if no recordings are written."""
        if self.folder is None:
            return
        from slam_init.output.summary import summary_of
        from slam_init.recording.rerun_recorder import RerunRecorder

        errors = compare_with_groundtruth(result.map.keyframes, source.groundtruth) if result.map is not None else None
        if isinstance(recorder, RerunRecorder):
            recorder.summary(summary_of(result, source, camera, self.method, self.seed, ground_truth=errors))
        folder = self._home()
        try:
            save_snapshot(folder / snapshot_name(self.method), result, self.start, source.groundtruth)
        except OSError as error:
            raise output_error(folder, error) from error

    def _home(self) -> Path:
        return recording_folder(str(self.folder), self.label, self.start)


@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """The map of a trial, or the reason why there is no map."""

    #: (A, 3) Second frame, verdict and advice of each attempt.
    verdicts: np.ndarray[tuple[int, ...], np.dtype[np.str_]]
    #: Why there is no map; empty if there is a map.
    reason: str
    #: Absolute index of the last frame that was read. A map was accepted at this frame.
    last_frame: int
    #: (K, 4, 4) World_from_cam of the keyframes; empty if there is no map.
    poses: Floats
    #: (L, 3) Landmarks in the world frame of the map.
    points: Floats
    #: (L, 3) Colours of the landmarks, RGB.
    colors: Image
    #: (N, 3) True camera positions from the first keyframe to the last, aligned with the map by a similarity; empty
    #: if there is no ground truth.
    truth: Floats


def save_snapshot(path: str | os.PathLike[str], result: Result, start: int, truth: Trajectory | None) -> None:
    """Write the snapshot of a trial."""
    attempts = [(str(a.frames[1] if len(a.frames) > 1 else -1), a.verdict, a.advice) for a in result.attempts]
    map_ = result.map
    keyframes = () if map_ is None else map_.keyframes
    poses = np.array([keyframe.world_from_cam.matrix() for keyframe in keyframes]).reshape(-1, 4, 4)
    snapshot = MapSnapshot(
        verdicts=np.array(attempts, np.str_).reshape(-1, 3),
        reason=result.reason or "",
        last_frame=start + result.frames_read - 1,
        poses=poses,
        points=np.zeros((0, 3)) if map_ is None else map_.points,
        colors=np.zeros((0, 3), np.uint8) if map_ is None else map_.colors,
        truth=true_path(keyframes, truth),
    )
    np.savez(path, **vars(snapshot))


def load_snapshot(path: str | os.PathLike[str]) -> MapSnapshot:
    """Read a snapshot."""
    with np.load(path) as stored:
        fields = {name: stored[name] for name in stored.files}
    return MapSnapshot(**fields | {"reason": str(fields["reason"]), "last_frame": int(fields["last_frame"])})
