"""The decision on a frame: by the risk that the map of the best hypothesis is wrong, and by the depths of this map.

quest proposes motions from the pairs that the keyframe manager chooses. A motion is the poses of the views of a window,
with their lens, and a plane where there is one (:class:`slam_init.window.motion.Motion`). From then on the motions
live: each further frame joins their joint fit, and the risk is stated again. What follows from a window is a function
of it (:mod:`slam_init.decision.evaluated_window`). A map is built for an accepted motion, for the two motions of an
undecided plane or of the scene and a large object, or on request (:mod:`slam_init.decision.window_map`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quest.estimate import RelativePose
from slam_init.bundle.problem import BundleSolution
from slam_init.config import Config
from slam_init.decision.depths import depth_gates
from slam_init.decision.evaluated_window import EvaluatedWindow, WindowViews
from slam_init.decision.focal_check import FocalCheck
from slam_init.decision.lens import priors_of
from slam_init.decision.map_candidates import Outcome
from slam_init.decision.screening import LEAST_PARALLAX_SHARE
from slam_init.decision.two_views import (
    MatchedPair,
    Proposer,
    pose_at_fitting_threshold,
    pose_evidence,
    refuse_two_views,
    with_established_reason,
)
from slam_init.decision.window_map import WindowMaps
from slam_init.frontend.keyframes import PairPreview
from slam_init.frontend.rolling_shutter import RollingShutter
from slam_init.mapping.views import further_views
from slam_init.types.camera import Camera
from slam_init.types.evidence import FreeFocal, MapEvidence
from slam_init.types.frame import Observations
from slam_init.types.history import History
from slam_init.types.pose import Pose
from slam_init.types.refusal import GateName, Stage, Verdict, at_least
from slam_init.types.result import Attempt, ProvisionalMap
from slam_init.types.stopwatch import Stopwatch
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.levels import EVEN_ODDS, FLOOR, WRONG_DIRECTION_DEG
from slam_init.window.live import LiveHypotheses
from slam_init.window.motion import OtherMotion
from slam_init.window.risk import WindowRisk, risk_of, with_zooming_rotation
from slam_init.window.tracks import MAX_VIEWS
from slam_init.window.uncertainty import significant_readout_s

#: Frames that are not evaluated where the last window, of so many views or more, left this standard deviation of the
#: direction (degrees): twice what is wrong. In a steady motion it falls with the power 3/2 of the views, so that ten
#: views in place of six leave half of it, which is no map. A sudden motion shows in the score of the pairs.
#: Class: geometry, in frames, views and degrees.
_LONGEST_REST, _MANY_VIEWS, _FAR_DEG = 3, 6, 2 * WRONG_DIRECTION_DEG
#: After a window whose map is wrong at even odds or worse, this number of frames is not evaluated while the score has
#: grown by less than this factor: the tracks have less than half as much information again. With more frames left out,
#: motions are lost between two windows: of four simulated worlds without a map after three such frames, two have one
#: after one.
#: Class: level, as a factor and in frames.
_MORE_INFORMATIVE, _SKIPPED_AT_EVEN_ODDS = 1.2, 1
#: A camera that turns for long shows as little after a hundred frames as after ten. So either number may grow to this
#: share of the frames so far, and a map comes later by that share at the most. Before a camera that turns in the hand
#: (TUM fr1/rpy) a frame takes 43 ms in the median, and 227 if all are evaluated.
#: Class: level, as a share.
_SHARE_OF_FRAMES = 0.1


class WindowRule:
    """Evaluates the frames of a video by the joint estimate of their window.

    * ``history``: Holds the candidate references and the frames between them, and knows the current lens.
    * ``shutter``: Corrects the rays of the history; the window estimates an unknown readout.
    * ``third_view``: Whether further views join the window. Without them the window holds reference and current alone.
    * ``propose``: Estimates the relative pose of a chosen pair; by default quest does.
    """

    def __init__(
        self,
        config: Config,
        history: History,
        shutter: RollingShutter,
        *,
        third_view: bool = True,
        propose: Proposer | None = None,
    ) -> None:
        self._config = config
        self._history = history
        self._shutter = shutter
        self._third_view = third_view
        self._propose_pose = propose or pose_at_fitting_threshold
        self._live = LiveHypotheses(config.map.min_noise_px)
        self._focal_check = FocalCheck()
        self._skipper = FrameSkipper()
        self._threshold_rad = config.two_view.threshold_px / history.camera.focal_px
        self._proposed_from: int | None = None
        self._only_rotated = False
        # The maps of the last evaluated window.
        self._last: WindowMaps | None = None
        # The motion of other tracks in the last window that was searched for one.
        self._other = OtherMotion()

    def evaluate(
        self,
        chosen: PairPreview | None,
        pairs: Sequence[PairPreview],
        current: Observations,
        stopwatch: Stopwatch,
    ) -> Outcome | None:
        """Evaluate a frame.

        * ``chosen``: The pair that quest proposes new motions from; None where no pair is worth it.
        * Returns: None where the frame is not evaluated. That is so where the last window was so far from a map that
          this frame cannot be enough. It is also so where no pair was chosen and no known motion can go on: there is
          none, the window holds the pair alone, or its last reference is no candidate now.
        """
        last = None if self._last is None else self._last.window
        if self._skipper.count_and_skip(max((pair.direction_score for pair in pairs), default=0.0), last):
            return None
        # Without a pair to try, earlier motions go on from the reference of the last proposal.
        preview = chosen or next((pair for pair in pairs if pair.reference == self._proposed_from), None)
        # Without further views, an earlier motion has only the reference in common with the window.
        lives_on = bool(self._live) and self._third_view
        if preview is None or not (chosen or lives_on):
            return None
        views = self._views(preview, current)
        # Accepted until a gate or a rule refuses it.
        attempt = Attempt(
            frames=(preview.reference, preview.current),
            verdict=Verdict.ACCEPTED,
            pixels1=views.pair.pixels1,
            pixels2=views.pair.pixels2,
            inliers=np.zeros(len(views.pair.rays1), bool),
            preview=preview.evidence,
        )
        if self._only_rotated and all(one.parallax_share < LEAST_PARALLAX_SHARE for one in pairs):
            # The joint fit of a rotation-only camera takes the most steps, and no pair adds information.
            outcome = Outcome(attempt.refused_at(Verdict.PURE_ROTATION, Stage.MOTION))
        else:
            outcome = self._propose_and_fit(chosen, views, attempt, stopwatch)
        # "Pure rotation" stays the reason only where the tracks show that the camera merely rotates.
        return replace(outcome, attempt=with_established_reason(self._history.camera, outcome.attempt))

    def end(self) -> FreeFocal | None:
        """End the frames: the free fit of the focal length in the last window, if it is due."""
        return self._focal_check.at_end()

    def provisional(self) -> ProvisionalMap | None:
        """Build the map of the best motion of the last window.

        * Returns: None where there is no motion, or where its map cannot be built.
        """
        return None if self._last is None else self._last.provisional()

    @property
    def motion(self) -> tuple[dict[int, Pose], Camera] | None:
        """The poses (cam_from_world) of the best motion of the last window, and the camera that was fitted with it."""
        last = None if self._last is None else self._last.window
        return None if last is None else (last.best.motion.cam_from_world, last.lens_of_best.camera)

    # -- parts of the evaluation -------------------------------------------------------------------

    def _propose_and_fit(
        self, chosen: PairPreview | None, views: WindowViews, attempt: Attempt, stopwatch: Stopwatch
    ) -> Outcome:
        """Propose motions where a pair was chosen, and evaluate all that are known."""
        if chosen is not None:
            camera, pair, self._proposed_from = self._history.camera, views.pair, chosen.reference
            with stopwatch("two_view"):
                pose, self._threshold_rad = self._propose_pose(camera, self._config, pair)
            attempt = replace(attempt, two_view=pose_evidence(camera, pose))
            if isinstance(pose, RelativePose):
                attempt = replace(attempt, inliers=pose.inliers)
                noise_px = max(self._config.map.min_noise_px, pose.noise_rad * camera.focal_px)
                frames = (chosen.reference, chosen.current)
                self._live.propose(pose, frames, pair.rays1, pair.rays2, noise_px, self._shutter.readout_s)
            if not self._live:
                self._last = None
                return Outcome(refuse_two_views(camera, self._config, attempt, pose))
        with stopwatch("map"):
            return self._fit_and_state_risk(attempt, views)

    def _fit_and_state_risk(self, attempt: Attempt, views: WindowViews) -> Outcome:
        """Fit the motions to the window, state the risk, and build the map where it is small.

        The check of the focal length may still refuse an accepted window.
        """
        try:
            found = self._hypotheses_and_risk(views)
        except np.linalg.LinAlgError as error:
            # A degenerate window: its motions must not be the start of the next one.
            self._live.forget()
            found = None
            attempt = replace(attempt, map=MapEvidence(failure=f"the window has no solution: {error}"))
        if found is None:
            self._last = None
            return Outcome(attempt.refused_at(Verdict.NO_CONSISTENT_MOTION, Stage.MAP))
        hypotheses, risk = found
        pair = self._adopt_readout(views.pair, risk)
        window = EvaluatedWindow(pair, hypotheses, risk, self._history.lens, self._threshold_rad)
        self._last = WindowMaps(window, self._config, self._history, self._shutter)
        # A camera that merely rotates is evaluated again once a pair shows parallax.
        self._only_rotated = window.only_rotates
        outcome = self._accept_or_refuse(self._last, window.with_evidence(attempt))
        free = self._focal_check.check(window, accepted=outcome.accepted is not None)
        outcome = replace(outcome, attempt=replace(outcome.attempt, free_focal=free))
        if outcome.accepted is not None and free is not None and free.contradicts:
            refused = outcome.attempt.refused_at(Verdict.WRONG_FOCAL_LENGTH, Stage.MAP)
            outcome = Outcome(refused, lens=window.next_lens)
        # The motions follow the lens here, and the history in :class:`slam_init.initializer.Initializer`.
        self._live.change_lens(window.lens, outcome.lens or window.lens)
        return replace(outcome, motion=window.motion, margin=risk.margin)

    def _hypotheses_and_risk(self, views: WindowViews) -> tuple[WindowHypotheses, WindowRisk] | None:
        """The hypotheses of a window and the risk of the best one; None without hypotheses."""
        lens, history = self._history.lens, self._history
        measured = [history.relative_rotations.get(view.frame) for view in views.all]
        hypotheses = self._live.fitted(lens.camera, priors_of(lens, self._config), views.all, measured)
        if hypotheses is None:
            return None
        hypotheses = replace(hypotheses, overlay=views.overlay)
        # What was undecided stays a question in the next windows, whose pairs may not show it again.
        if self._other.probability > FLOOR:
            hypotheses = replace(hypotheses, other_before=self._other)
        max_risk = self._config.acceptance.max_risk
        risk = _complete_risk(hypotheses, max_risk)
        if risk.total <= max_risk and (better := self._live.with_better_motion(hypotheses)) is not None:
            hypotheses, risk = better, _complete_risk(better, max_risk)
            self._live.keep(hypotheses)
        if risk.seeks_objects:
            self._other = risk.other
        return hypotheses, risk

    def _accept_or_refuse(self, maps: WindowMaps, attempt: Attempt) -> Outcome:
        """Refuse a window by its gates, or build its map."""
        window = maps.window
        gates = window.gates(self._config.acceptance.max_risk)
        attempt = attempt.with_gates(gates)
        if not all(gate.passes() for gate in gates):
            refused = attempt.refused_by(Stage.MAP, gates)
            return Outcome(refused, undecided=maps.undecided(refused.verdict), lens=window.next_lens)
        bundle, table = maps.candidate()
        attempt = replace(attempt, frames=table.frames)
        # The frames after the map see through its lens.
        lens = window.lens_of_best
        if not isinstance(bundle, BundleSolution):
            attempt = replace(attempt, map=MapEvidence(failure=bundle.cause))
            return Outcome(attempt.refused_at(Verdict.BUNDLE_ADJUSTMENT_FAILED, Stage.MAP), lens=lens)
        evidence = MapEvidence(bundle.rmse_px, pose_prior=bundle.problem.prior is not None)
        limits, landmarks = self._config.acceptance, len(bundle.problem.points)
        enough = at_least(GateName.LANDMARKS, landmarks, limits.min_landmarks, Verdict.TOO_FEW_LANDMARKS)
        on_map = (*depth_gates(bundle, limits), enough)
        attempt = replace(attempt, map=evidence).with_gates(on_map)
        if not all(gate.passes() for gate in on_map):
            return Outcome(attempt.refused_by(Stage.MAP, on_map), lens=lens)
        risk = maps.risk_of_map(bundle)
        if risk.total > self._config.acceptance.max_risk:
            failure = f"the adjusted motion differs from that of the window: risk {risk.total:.2g}"
            attempt = replace(attempt, map=MapEvidence(failure=failure))
            return Outcome(attempt.refused_at(Verdict.BUNDLE_ADJUSTMENT_FAILED, Stage.MAP), lens=lens)
        # The stated risk is that of the map.
        attempt = replace(window, risk=risk).with_evidence(attempt)
        gates = [replace(one, value=risk.total) if one.name == GateName.RISK else one for one in attempt.gates]
        attempt = replace(attempt, gates=tuple(gates), progress=1.0)
        return Outcome(attempt, maps.built(bundle, risk.total), maps.views_of(bundle), lens=lens)

    def _views(self, preview: PairPreview, current: Observations) -> WindowViews:
        """The matches of a pair and the further views."""
        pair = MatchedPair(preview, self._history[preview.reference], current)
        most, known = MAX_VIEWS - 2, self._live.frames
        further = further_views(self._history, pair.reference, current, self._config.map, most, known)
        views = WindowViews.of(pair, further)
        return views if self._third_view else replace(views, further=())

    def _adopt_readout(self, pair: MatchedPair, risk: WindowRisk) -> MatchedPair:
        """Correct the rays of the history for the readout that the window found; return the pair with these rays."""
        is_known = risk.lens.readout_sigma_s == 0
        if is_known or not self._shutter.adopt(self._history, significant_readout_s(risk.lens)):
            return pair
        return self._views(pair.preview, self._history[pair.current.frame]).pair


def _complete_risk(hypotheses: WindowHypotheses, max_risk: float) -> WindowRisk:
    """The risk of the best hypothesis, with the camera that rotates and zooms where all other terms are small."""
    risk = risk_of(hypotheses, max_risk)
    return with_zooming_rotation(hypotheses, risk) if risk.total <= max_risk else risk


class FrameSkipper:
    """Leaves out frames after windows that were far from a map, since an evaluation takes most of the time of a frame.

    A frame that is left out still joins the history, and later windows. A frame without motion never comes here.
    """

    def __init__(self) -> None:
        # The best score of the pairs of the last frame that was not left out.
        self._score = 0.0
        self._skipped, self._frames = 0, 0

    def count_and_skip(self, score: float, last: EvaluatedWindow | None) -> bool:
        """Whether a frame is left out; called once a frame.

        * ``score``: The best score of its pairs (:attr:`~slam_init.frontend.keyframes.PairPreview.direction_score`).
        * ``last``: The last window; None without one.
        """
        self._frames += 1
        if last is not None and self._skipped < self._most(score, last):
            self._skipped += 1
            return True
        self._score, self._skipped = score, 0
        return False

    def _most(self, score: float, last: EvaluatedWindow) -> int:
        """The number of frames in a row that may be left out after a window."""
        share = int(_SHARE_OF_FRAMES * self._frames)
        if len(last.best.rows) < _MANY_VIEWS:
            return 0
        if last.risk.directions.sigma_deg * self._score > _FAR_DEG * score:
            return max(_LONGEST_REST, share)
        if last.risk.total > EVEN_ODDS and score < _MORE_INFORMATIVE * self._score:
            return max(_SKIPPED_AT_EVEN_ODDS, share)
        return 0
