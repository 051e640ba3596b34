"""The interface of a recorder: the pipeline reports each step of a run to it.

A :class:`Recorder` ignores all reports. :class:`slam_init.recording.rerun_recorder.RerunRecorder` writes them to a file
for the Rerun viewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Self

from slam_init.output.summary import Summary
from slam_init.types.arrays import Floats
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.result import Attempt
from slam_init.types.scale import Scale


class Recorder:
    """Receives the reports of a run and ignores them. It is also a context manager that closes itself."""

    def frame(self, frame: Frame, observations: Observations) -> None:
        """Report a frame and its tracks. The reports that follow belong to this frame."""

    def attempt(self, attempt: Attempt) -> None:
        """Report an attempt."""

    def frame_time(self, elapsed_ms: float) -> None:
        """Report what a frame took."""

    def row_times(self, observations: Observations, corrected: Floats) -> None:
        """Report what the correction of a rolling shutter moves in a frame.

        Shapes: ``corrected`` (N, 2).

        * ``corrected``: Their pixels as if all rows were taken at the time of the middle one.
        """

    def initialized(self, map_: InitialMap, observations: Sequence[Observations]) -> None:
        """Report an accepted map."""

    def undecided(self, maps: Sequence[InitialMap]) -> None:
        """Report the maps that the views could not decide between.

        * ``maps``: The better one first. Empty if the earlier ones are no longer kept.
        """

    def continued(self, keyframe: Keyframe) -> None:
        """Report a frame after the initialization that was located in the map."""

    def scaled(self, scale: Scale) -> None:
        """Report the scale of the last map."""

    def restarted(self) -> None:
        """Report that the map was lost, and that the initialization starts anew."""

    def summary(self, summary: Summary) -> None:
        """Report the summary at the end of the run."""

    def close(self) -> None:
        """End the reports. It may be called twice."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Several(Recorder):
    """Passes each report to several recorders, in their order."""

    def __init__(self, *recorders: Recorder) -> None:
        self._recorders = recorders

    def frame(self, frame: Frame, observations: Observations) -> None:
        """Report a frame and its tracks."""
        for recorder in self._recorders:
            recorder.frame(frame, observations)

    def attempt(self, attempt: Attempt) -> None:
        """Report an attempt."""
        for recorder in self._recorders:
            recorder.attempt(attempt)

    def frame_time(self, elapsed_ms: float) -> None:
        """Report what a frame took."""
        for recorder in self._recorders:
            recorder.frame_time(elapsed_ms)

    def row_times(self, observations: Observations, corrected: Floats) -> None:
        """Report what the correction of a rolling shutter moves in a frame.

        Shapes: ``corrected`` (N, 2).
        """
        for recorder in self._recorders:
            recorder.row_times(observations, corrected)

    def initialized(self, map_: InitialMap, observations: Sequence[Observations]) -> None:
        """Report an accepted map."""
        for recorder in self._recorders:
            recorder.initialized(map_, observations)

    def undecided(self, maps: Sequence[InitialMap]) -> None:
        """Report the maps that the views could not decide between."""
        for recorder in self._recorders:
            recorder.undecided(maps)

    def continued(self, keyframe: Keyframe) -> None:
        """Report a frame after the initialization."""
        for recorder in self._recorders:
            recorder.continued(keyframe)

    def scaled(self, scale: Scale) -> None:
        """Report the scale of the last map."""
        for recorder in self._recorders:
            recorder.scaled(scale)

    def restarted(self) -> None:
        """Report that the map was lost."""
        for recorder in self._recorders:
            recorder.restarted()

    def summary(self, summary: Summary) -> None:
        """Report the summary at the end of the run."""
        for recorder in self._recorders:
            recorder.summary(summary)

    def close(self) -> None:
        """End the reports of all recorders."""
        for recorder in self._recorders:
            recorder.close()
