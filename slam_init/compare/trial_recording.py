"""The recording of one trial, and the snapshot of its map for the recording of all methods."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from slam_init.compare.recordings import recording_folder, recording_name, snapshot_name
from slam_init.output.folder import output_error
from slam_init.recording.recorder import Recorder

if TYPE_CHECKING:
    from slam_init.datasets import TimedSource
    from slam_init.datasets.points import PointSource
    from slam_init.types.camera import Camera
    from slam_init.types.result import Result


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
        from slam_init.compare.map_snapshot import save_snapshot
        from slam_init.evaluation.metrics import compare_with_groundtruth
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
