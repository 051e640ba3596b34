"""The frames of a video, and the maps that are candidates of its result.

An accepted map grows by the next frames until it is final. ``Config.refine_frames`` says for how many frames. By
default these are as many as it takes until the median deviation of its depths, with the errors that tracks share, is at
most ``acceptance.max_depth_sigma``. The gate of the acceptance knows the noise of single tracks only. A map that is
lost is final as it was before the loss.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from slam_init.config import Config
from slam_init.decision.attempt_log import AttemptLog, focal_notes
from slam_init.recording.recorder import Recorder
from slam_init.types.camera import Camera
from slam_init.types.evidence import Margin
from slam_init.types.frame import Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.lens import CurrentLens
from slam_init.types.result import MAX_SEGMENTS, Attempt, Result, Segment
from slam_init.types.stopwatch import StageTimes

if TYPE_CHECKING:
    from slam_init.decision.current_pose import WindowMotion
    from slam_init.mapping.growing import GrowingMap, Located


@dataclass(frozen=True, eq=False)
class Outcome:
    """The end of an attempt: its verdict, and the maps that it leaves."""

    #: The verdict and its evidence.
    attempt: Attempt
    #: A map that passed all gates.
    accepted: InitialMap | None = None
    #: The observations of its keyframes, in the same order. The history may have dropped them.
    views: tuple[Observations, ...] = ()
    #: Builds the maps of two motions that the tracks do not decide between, the better one first; None without two.
    undecided: Callable[[], tuple[InitialMap, ...]] | None = None
    #: The vote between the best motion and its nearest competing motion; None without one.
    margin: Margin | None = None
    #: The poses of the cameras of the evaluated window; None where no window was evaluated.
    motion: WindowMotion | None = None
    #: The lens to go on with; None where no window was evaluated.
    lens: CurrentLens | None = None


class MapCandidates:
    """The maps of the attempts up to now: an accepted map, or two undecided maps, and the segments before a restart.

    Two maps are undecided where they are those of both motions of a plane, or of the scene at rest and a large object.

    * ``recorder``: Receives a report when a map is accepted or has grown, and at the end two undecided maps.
    * ``frames``: Number of frames since the start.
    * ``refined``: Number of frames that the accepted map has grown by.
    * ``is_final``: Whether there is an accepted map that does not grow any more.
    * ``margin``: The vote of the accepted map, if it had one. Before that, the last vote between two maps.
    """

    def __init__(self, recorder: Recorder, config: Config) -> None:
        self._recorder, self._config = recorder, config
        self._earlier: deque[Segment] = deque(maxlen=MAX_SEGMENTS)
        self._forget()

    def _forget(self) -> None:
        self._growing: GrowingMap | None = None
        self._first: int | None = None
        self.frames, self.refined = 0, 0
        self.is_final = False
        self.accepted: InitialMap | None = None
        self._undecided: Callable[[], tuple[InitialMap, ...]] = tuple
        self.margin: Margin | None = None

    def count(self, frame: int) -> None:
        """Count a frame."""
        self.frames += 1
        self._first = frame if self._first is None else self._first

    def restart(self) -> None:
        """Restart; an accepted map becomes a segment."""
        self._earlier.extend(self._current_segment())
        self._forget()

    @property
    def segments(self) -> tuple[Segment, ...]:
        """The maps up to now, with those before a restart; empty without a restart."""
        return (*self._earlier, *self._current_segment()) if self._earlier else ()

    def _current_segment(self) -> tuple[Segment, ...]:
        """The accepted map as a segment; empty without one."""
        if self.accepted is None or self._first is None:
            return ()
        return (Segment(self.accepted, self._first, self.frames - self.refined),)

    def keep(self, outcome: Outcome) -> None:
        """Keep the maps of an attempt, and drop the maps that it contradicts."""
        if outcome.margin is not None or outcome.accepted is not None:
            self.margin = outcome.margin
        if outcome.accepted is not None:
            self.accepted, most = outcome.accepted, self._config.refine_frames
            self.is_final = most == 0 or (most is None and self._knows_depths(self.accepted))
            self._recorder.initialized(self.accepted, outcome.views)
            return
        # Two undecided maps are kept until two other maps replace them, or a vote decides.
        if outcome.undecided is not None:
            self._undecided = cache(outcome.undecided)
        elif outcome.margin is not None and outcome.margin.decides():
            self._undecided = tuple

    @property
    def hypotheses(self) -> tuple[InitialMap, ...]:
        """The accepted map, or the two undecided ones, which are built when they are asked for."""
        return self._undecided() if self.accepted is None else (self.accepted,)

    @property
    def lost_at(self) -> int | None:
        """Absolute index of the first frame in which the accepted map was lost; None while it is not."""
        return None if self._growing is None else self._growing.lost_at

    def locate(self, observed: Observations, revised: Sequence[Observations]) -> Located | None:
        """Locate a frame in the accepted map, which grows by it. There is a map."""
        if self._growing is None:
            from slam_init.mapping.growing import GrowingMap  # with the adjustment: a camera that waits needs neither

            assert self.accepted is not None
            self._growing = GrowingMap(self.accepted, self._config.map)
        self.refined += 1
        keyframes = self._growing.keyframes_added
        located = self._growing.locate(observed, revised)
        if located is not None:
            self._recorder.continued(located.keyframe)
        most = self._config.refine_frames
        if most is not None:
            enough = self.refined >= most
        else:  # keyframes alone change the depths
            enough = self._growing.keyframes_added > keyframes and self._knows_depths(self._growing.grown())
        if self._growing.lost_at is not None or enough:
            self._end_growth()
        return located

    def finalize(self) -> None:
        """Take the accepted map as it has grown; without one, report the undecided maps."""
        if self.accepted is None and self.hypotheses:
            self._recorder.undecided(self.hypotheses)
        if self.accepted is not None and not self.is_final:
            self._end_growth()

    def result(
        self, attempts: AttemptLog, camera: Camera, notes: tuple[str, ...], timing_ms: Mapping[str, StageTimes]
    ) -> Result:
        """The result up to now: the map, or the reason why there is none and the undecided maps."""
        map_, lost = self.accepted, self.lost_at
        reason = attempts.prevailing_reason() if map_ is None else None
        lost_note = () if lost is None else (f"the map was lost at frame {lost}, while it grew",)
        return Result(
            map=map_,
            reason=reason,
            frames_read=self.frames,
            frames_to_init=None if map_ is None else self.frames - self.refined,
            attempts=attempts.kept,
            timing_ms=timing_ms,
            notes=(*notes, *attempts.notes(), *focal_notes(map_, self._config.map), *lost_note),
            advice="" if reason is None else attempts.advice(reason),
            hypotheses=self.hypotheses,
            margin=self.margin,
            segments=self.segments,
            camera=camera,
            wrong_focal=attempts.wrong_focal,
            method=self._config.method,
            seed=self._config.seed,
        )

    def _knows_depths(self, map_: InitialMap) -> bool:
        return map_.depth_sigma <= self._config.acceptance.max_depth_sigma

    def _end_growth(self) -> None:
        """Make the accepted map final as it has grown."""
        self.is_final = True
        if self._growing is not None and (grown := self._growing.grown()) is not self.accepted:
            self.accepted = grown
            self._recorder.refined(grown)
