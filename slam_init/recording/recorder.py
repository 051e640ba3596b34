"""The interface of a recorder: the pipeline reports each step of a run to it.

A :class:`Recorder` ignores all reports. :class:`slam_init.recording.rerun_recorder.RerunRecorder` writes them to a file
for the Rerun viewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from slam_init.types.arrays import Floats
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.result import Attempt
from slam_init.types.scale import Scale
from slam_init.types.status import CameraPose


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

    def waiting(self, pose: CameraPose) -> None:
        """Report what is known of the pose of the newest camera while there is no map."""

    def initialized(self, map_: InitialMap, observations: Sequence[Observations]) -> None:
        """Report an accepted map."""

    def undecided(self, maps: Sequence[InitialMap]) -> None:
        """Report the maps that the views could not decide between.

        * ``maps``: The better one first. Empty if the earlier ones are no longer kept.
        """

    def continued(self, keyframe: Keyframe) -> None:
        """Report a frame after the initialization that was located in the map."""

    def refined(self, map_: InitialMap) -> None:
        """Report the accepted map as it has grown."""

    def scaled(self, scale: Scale) -> None:
        """Report the scale of the last map."""

    def restarted(self) -> None:
        """Report that the map was lost, and that the initialization restarts."""

    def close(self) -> None:
        """End the reports. It may be called twice."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.close()
