"""Laws of which frames of a video the rule of the window evaluates."""

import numpy as np
from make_pair import preview_of
from make_scene import history_of
from make_window import WINDOW_CONFIG, point_source

from slam_init.decision.screening import LEAST_PARALLAX_SHARE
from slam_init.decision.window_rule import WindowRule
from slam_init.frontend.rolling_shutter import RollingShutter
from slam_init.initializer import Initializer
from slam_init.types.refusal import Verdict
from slam_init.types.stopwatch import Stopwatch

#: Fewer tracks than the default, where a law does not ask for more: the fits take as much less time.
FEWER = 150


class Frames:
    """Frames of a source that a rule evaluates one by one, each paired with the first frame."""

    def __init__(self, source):
        self.observations = list(source.observations())
        self.rule = WindowRule(
            WINDOW_CONFIG, history_of(self.observations, source.camera), RollingShutter(source.camera)
        )
        self.camera = source.camera

    def evaluate(self, k, *, chosen, reference=0):
        """The outcome of frame k, whose pair is chosen or not."""
        pair = preview_of([self.observations[reference], self.observations[k]], self.camera)
        return self.rule.evaluate(pair if chosen else None, [pair], self.observations[k], Stopwatch())


def test_images_of_noise_have_no_consistent_motion():
    rng, initializer = np.random.default_rng(0), Initializer()
    for time_s in (0.0, 1.0, 2.0):
        status = initializer.process(rng.integers(0, 256, (240, 320), np.uint8), time_s)
    assert status.reason == Verdict.NO_CONSISTENT_MOTION and "noise" in status.advice


def test_before_a_motion_is_known_a_frame_without_a_chosen_pair_is_not_evaluated():
    frames = Frames(point_source("room", 0, baseline=0.03))
    assert frames.evaluate(1, chosen=False) is None
    assert frames.rule.provisional() is None
    assert frames.evaluate(2, chosen=True).attempt.window is not None


def test_motions_live_on_in_frames_without_a_chosen_pair_and_can_be_accepted_there():
    frames = Frames(point_source("wall", 0, views=8, baseline=0.3, points=FEWER))
    outcomes = [frames.evaluate(1, chosen=True), *(frames.evaluate(k, chosen=False) for k in range(2, 8))]
    for k, outcome in enumerate(outcomes, 1):
        attempt = outcome.attempt
        assert attempt.frames[:2] == (0, k)
        assert (attempt.two_view is not None) == (k == 1)  # quest is not asked again
        assert attempt.window.views == k + 1
        assert attempt.inliers.any()
    assert outcomes[0].accepted is None
    accepted = [outcome for outcome in outcomes if outcome.accepted is not None]
    assert accepted
    assert accepted[-1] is outcomes[-1]


def test_after_a_mere_rotation_no_window_is_fitted_until_a_pair_shows_parallax():
    frames = Frames(point_source("rotation", 3, focal_error=0.05, noise_px=0.3))
    evaluated = [frames.evaluate(k, chosen=True).attempt for k in range(1, 12)]
    # The first degree establishes no rotation yet.
    assert {attempt.verdict for attempt in evaluated[1:]} == {Verdict.PURE_ROTATION}
    first = next(k for k, attempt in enumerate(evaluated) if attempt.window is not None)
    assert evaluated[first].window.risk_rotation > 0.5
    still = [attempt for attempt in evaluated[first + 1 :] if attempt.preview.parallax_share < LEAST_PARALLAX_SHARE]
    assert still
    assert all(attempt.window is None and attempt.two_view is None for attempt in still)


def test_a_frame_without_a_chosen_pair_is_evaluated_with_the_reference_of_the_last_chosen_pair():
    frames = Frames(point_source("wall", 0, baseline=0.3))
    assert frames.evaluate(3, chosen=True, reference=1).accepted is None
    assert frames.evaluate(4, chosen=False, reference=0) is None
    assert frames.evaluate(4, chosen=False, reference=1).attempt.frames[:2] == (1, 4)


def test_a_window_whose_equations_have_no_solution_is_refused(monkeypatch):
    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    frames = Frames(point_source("room", 0, baseline=0.03))
    with monkeypatch.context() as patched:
        patched.setattr("slam_init.decision.window_rule.risk_of", singular)
        refused = frames.evaluate(2, chosen=True)
    assert refused.attempt.verdict == Verdict.NO_CONSISTENT_MOTION
    assert refused.attempt.map.failure == "the window has no solution: Singular matrix"
    assert frames.evaluate(3, chosen=False) is None  # its motions are forgotten
    assert frames.evaluate(4, chosen=True).attempt.window is not None
