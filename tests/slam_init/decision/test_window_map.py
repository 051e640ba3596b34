"""Laws of the map of an evaluated window: what bundle adjustment may change of the motion."""

import numpy as np
from make_window import WINDOW_CONFIG, finished, is_right, point_source

from slam_init.decision import window_map
from slam_init.initializer import Initializer
from slam_init.types.refusal import Verdict


def test_a_map_that_bundle_adjustment_moves_away_is_refused_with_the_risk_that_this_makes(monkeypatch):
    monkeypatch.setattr(
        window_map.FittedMotion, "differences_deg", lambda fitted, _: dict.fromkeys(fitted.frames[1:], (0.0, 30.0))
    )
    source = point_source("room", 2, baseline=0.1)
    initializer, risks = Initializer(source.camera, WINDOW_CONFIG), []
    for observed in source.observations():
        assert not initializer.process_tracks(observed)
        attempt = initializer.status.attempt
        if attempt is not None and attempt.verdict == Verdict.BUNDLE_ADJUSTMENT_FAILED:
            assert attempt.window.risk <= WINDOW_CONFIG.acceptance.max_risk
            risks.append(initializer.provisional.risk)
        if len(risks) == 2:
            break
    assert len(risks) == 2
    assert min(risks) > 0.5


def test_a_map_that_the_adjustment_bends_holds_the_poses_of_the_window(monkeypatch):
    """Where the adjustment moves the pair by ten degrees without held poses, as with a wrong calibration."""
    source, adjusted, priors = point_source("room", 2, baseline=0.1), window_map.map_of_poses, []

    def bent(camera, config, table, poses, threshold_rad, prior=None, focal_factor=1.0):
        priors.append(prior)
        return adjusted(camera, config, table, poses, threshold_rad, prior, focal_factor)

    def differences_deg(fitted, _):
        held = len(priors) >= 2 and None not in priors[-2:] and priors[-1].direction_sigma_rad < np.radians(0.5)
        return dict.fromkeys(fitted.frames[1:], (0.0, 0.1) if held else (0.0, 7.0))

    monkeypatch.setattr(window_map, "map_of_poses", bent)
    monkeypatch.setattr(window_map.FittedMotion, "differences_deg", differences_deg)
    result = finished(source)
    assert result, result.reason
    assert is_right(source, result.map)
