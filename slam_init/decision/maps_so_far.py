"""The maps that the judgements of a video have led to."""

from __future__ import annotations

from slam_init.decision.outcome import Outcome
from slam_init.mapping.map_building import MapWithViews
from slam_init.recording.recorder import Recorder
from slam_init.types.comparison import Margin
from slam_init.types.initial_map import InitialMap


class MapsSoFar:
    """The maps of the attempts up to now: an accepted map, or two undecided maps.

    * ``recorder``: Receives a report when a map is accepted, and when the undecided maps change.
    * ``hypotheses``: The accepted map, or the two undecided ones.
    * ``margin``: The vote of the accepted map, if it had one. Before that, the last vote between two maps.
    """

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self.accepted: InitialMap | None = None
        self.hypotheses: tuple[InitialMap, ...] = ()
        self.margin: Margin | None = None

    def take(self, outcome: Outcome) -> None:
        """Keep the maps of an attempt, and drop the maps that it contradicts."""
        if outcome.margin is not None or outcome.accepted is not None:
            self.margin = outcome.margin
        if outcome.accepted is not None:
            self._accept(outcome.accepted)
            return
        # Two undecided maps are kept until two other maps replace them, or a vote decides.
        decided = outcome.margin is not None and outcome.margin.decides()
        if outcome.hypotheses or decided:
            self.hypotheses = outcome.hypotheses
            self._recorder.undecided(self.hypotheses)

    def _accept(self, built: MapWithViews) -> None:
        self.accepted = built.map
        self.hypotheses = (built.map,)
        self._recorder.initialized(built.map, built.views)
