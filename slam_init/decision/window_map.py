"""The map of an evaluated window: bundle-adjusted on all tracks of the pair, and refused where it cannot be used."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from quest.noise import GATE_SIGMAS
from slam_init.bundle.adjustment import restated
from slam_init.bundle.problem import BundleFailure, BundleSolution, PosePrior
from slam_init.config import Config
from slam_init.decision.evaluated_window import EvaluatedWindow
from slam_init.frontend.rolling_shutter import RollingShutter
from slam_init.mapping.map_building import initial_map, map_of_poses
from slam_init.mapping.views import TrackTable, table_of
from slam_init.types.frame import Observations
from slam_init.types.history import History
from slam_init.types.initial_map import InitialMap
from slam_init.types.lens import CALIBRATED_SIGMA
from slam_init.types.refusal import Verdict
from slam_init.types.result import ProvisionalMap
from slam_init.window.levels import EVEN_ODDS, RISK_OF_A_VIEW
from slam_init.window.motion import FittedMotion
from slam_init.window.risk import WindowRisk

#: Poses that are held have a prior with this share of their deviations, which moves them by a hundredth of what the
#: landmarks ask for where both know them alike.
#: Class: definition, as a share.
_HELD = 0.1


class WindowMaps:
    """Builds the maps of an evaluated window, from its frames as they were when it was evaluated.

    * ``history``: Holds the frames of the window now.
    * ``shutter``: Has corrected their rays.
    """

    def __init__(self, window: EvaluatedWindow, config: Config, history: History, shutter: RollingShutter) -> None:
        self.window, self._config = window, config
        self._views = {frame: history[frame] for frame in window.hypotheses.tracks.frames}
        self._gravities = {frame: one for frame, one in history.gravities.items() if frame in self._views}
        self._readout_s = shutter.readout_s

    def candidate(self) -> tuple[BundleSolution | BundleFailure, TrackTable]:
        """The map of the best motion, in the views that add little risk; it has not passed the gates yet.

        A view that is left out costs some landmarks only.
        """
        max_risk = self._config.acceptance.max_risk
        return self._true_to_motion(RISK_OF_A_VIEW * max_risk, max_risk)

    def undecided(self, reason: Verdict) -> Callable[[], tuple[InitialMap, ...]] | None:
        """What builds the maps of the two motions that the tracks do not decide between, the best first.

        These are both motions of a plane, or those of the scene and of a moving object that holds many tracks.

        * Returns: None where there are no two such motions. It gives no maps where one motion has none.
        """
        motions, risk = self.window.hypotheses.motions, self.window.risk
        if reason == Verdict.AMBIGUOUS_PLANE:
            return partial(self._both, motions[:2])
        other = risk.other.fitted if reason == Verdict.MOVING_OBJECTS and risk.other.probability else None
        return None if other is None or other.rows[1] != 1 else partial(self._both, (motions[0], other))

    def _both(self, motions: Sequence[FittedMotion]) -> tuple[InitialMap, ...]:
        both = [self._adjusted(motion)[0] for motion in motions]
        maps = tuple(self.built(one) for one in both if isinstance(one, BundleSolution))
        return maps if len(maps) == 2 else ()

    def provisional(self) -> ProvisionalMap | None:
        """The map of the best motion with its risk; None where it cannot be built."""
        bundle, _ = self._true_to_motion(self.window.risk.total, EVEN_ODDS)
        if not isinstance(bundle, BundleSolution):
            return None
        return ProvisionalMap(self.built(bundle, self.risk_of_map(bundle).total))

    def built(self, bundle: BundleSolution, risk: float | None = None) -> InitialMap:
        """The map of an adjusted bundle, with what the window knows of its camera."""
        lens, hypotheses = self.window.lens, self.window.hypotheses
        scene = "planar" if hypotheses.planar else "general"
        map_ = initial_map(bundle, self.views_of(bundle), scene, self._gravities)
        camera = map_.camera
        if lens.camera.readout_s is None and self._readout_s:
            camera = camera.with_readout(self._readout_s)
        if lens.is_unknown:
            sigma = min(self.window.focal_sigma, 1.0)
            camera = replace(camera, source="estimated", focal_sigma=sigma)
            factor = camera.fx / lens.stated.fx
            map_ = replace(map_, focal_factor=factor, focal_factor_sigma=factor * sigma)
        return replace(map_, camera=camera, model_risk=risk)

    def views_of(self, bundle: BundleSolution) -> tuple[Observations, ...]:
        """The observations of the keyframes of a map."""
        return tuple(self._views[frame] for frame in bundle.problem.frames)

    def risk_of_map(self, bundle: BundleSolution) -> WindowRisk:
        """The risk of an adjusted map, whose pair may be away from the motion of the window.

        Bundle adjustment holds the lens of a calibration, and does not know that points lie on a plane, nor the error
        fields.
        """
        return self.window.risk.of_map(*self._differences_deg(bundle)[self.window.best.frames[1]])

    def _differences_deg(self, bundle: BundleSolution) -> dict[int, tuple[float, float]]:
        """Differences of rotation and direction between map and window, for each frame of a map but the reference."""
        problem = bundle.problem
        return self.window.best.differences_deg(dict(zip(problem.frames, problem.world_from_cam, strict=True)))

    def _true_to_motion(self, of_view: float, of_pair: float) -> tuple[BundleSolution | BundleFailure, TrackTable]:
        """The map of the best motion, which bundle adjustment has not moved away from the motion.

        A further view whose own direction is riskier than ``of_view`` is left out, by the window or in the map. Where
        the risk of the pair exceeds ``of_pair`` in the map, the joint estimate gives priors of the poses. It knows more
        than the landmarks: tracks with uncertain depths, and that the points lie on a plane. It also knows that the
        lens may be off, whereas the adjustment holds the lens of a calibration and bends the poses: on a chessboard the
        directions of the window were off by 2.4 degrees in the median, those of the adjustment by 4.8. So the poses
        are held where even the priors leave the risk too large. Where the map is as likely wrong as right, the tracks
        contradict the motion.
        """
        frames, risk = self.window.certain_frames(of_view), self.window.risk
        bundle, table = self._without_moved_views(frames, of_view)
        if not isinstance(bundle, BundleSolution) or self.risk_of_map(bundle).total <= of_pair:
            return bundle, table
        prior = PosePrior(*np.radians([risk.directions.rotation_sigma_deg, risk.directions.sigma_deg]).tolist())
        bundle, table = self._without_moved_views(frames, of_view, prior)
        if not isinstance(bundle, BundleSolution) or not of_pair < self.risk_of_map(bundle).total <= EVEN_ODDS:
            return bundle, table
        bundle, table = self._without_moved_views(frames, of_view, prior.times(_HELD))
        return (restated(bundle, prior, self._config.map) if isinstance(bundle, BundleSolution) else bundle), table

    def _without_moved_views(
        self, frames: Sequence[int], of_view: float, prior: PosePrior | None = None
    ) -> tuple[BundleSolution | BundleFailure, TrackTable]:
        """The map of the best motion, in the pair and the further views that are no riskier than ``of_view`` in it.

        A further view that sees too few of the landmarks is left out too.
        """
        while True:
            bundle, table = self._adjusted(self.window.best, frames, prior)
            if isinstance(bundle, BundleSolution):
                differences = self._differences_deg(bundle)
                left = [frame for frame in frames[2:] if self._risk_of_view(frame, differences) <= of_view]
            else:
                left = [frame for frame in frames[2:] if frame != bundle.frame]
            kept = [*frames[:2], *left]
            if len(kept) == len(frames):
                return bundle, table
            frames = kept

    def _risk_of_view(self, frame: int, differences_deg: dict[int, tuple[float, float]]) -> float:
        """The risk that a further view of a map adds."""
        if frame not in differences_deg:  # bundle adjustment has left it out
            return 0.0
        view, risk = self.window.best.frames.index(frame) - 1, self.window.risk
        return risk.directions.of_views[view] + risk.directions.added_by_map(view, *differences_deg[frame])

    def _adjusted(
        self, motion: FittedMotion, frames: Sequence[int] | None = None, prior: PosePrior | None = None
    ) -> tuple[BundleSolution | BundleFailure, TrackTable]:
        """The bundle-adjusted map of a fitted motion, in the given frames. Its landmarks are tracks of the pair."""
        pair, lens, threshold_rad = self.window.pair, self.window.lens, self.window.threshold_rad
        views = [self._views[frame] for frame in (motion.frames if frames is None else frames)[2:]]
        table = table_of(pair.reference, pair.current, views)
        if self._readout_s:
            table = replace(table, pixels=np.array([lens.camera.project(bearings) for bearings in table.bearings]))
        poses, state = motion.motion.cam_from_world, motion.fit.state
        if lens.is_unknown:
            camera = lens.moved(state.lens.log_scale, state.lens.k1).camera
            table = replace(table, bearings=np.array([camera.bearings(pixels) for pixels in table.pixels]))
            return map_of_poses(camera, self._config, table, poses, threshold_rad, prior), table
        options = self._config.map
        # A focal length that is certain to be off would bend the map. An estimate within its own standard deviation is
        # no reason to leave a calibration: errors that neighbouring tracks share pull it by a tenth on a board.
        sigma = self.window.risk.lens.focal_sigma
        if abs(state.lens.log_scale) > max(CALIBRATED_SIGMA, GATE_SIGMAS * sigma):
            options = replace(options, refine_focal=True, focal_sigma=CALIBRATED_SIGMA)
        config, factor = replace(self._config, map=options), math.exp(state.lens.log_scale)
        return map_of_poses(lens.camera, config, table, poses, threshold_rad, prior, factor), table
