"""Laws of the hypotheses that live: frames carry them, and a better motion replaces a local optimum."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import PRIORS, hypotheses_of, is_motion_of, point_source, pose_of_pair

from slam_init.window.live import LiveHypotheses


def window(observations, last, reference=0):
    """Reference, current, and the frames between."""
    return [observations[reference], observations[last], *observations[reference + 1 : last]]


def propose(live, source, views):
    pose, rays1, rays2 = pose_of_pair(source.camera, *views[:2])
    live.propose(pose, (views[0].frame, views[1].frame), rays1, rays2, 0.7)
    return pose


@pytest.mark.parametrize(("scene", "seed", "baseline"), [("room", 0, 0.15), ("wall", 2, 0.3)])
def test_a_warm_started_motion_is_that_of_the_last_window_fitted_from_its_own_pair(scene, baseline, seed):
    source = point_source(scene, seed, baseline=baseline)
    observations = list(source.observations())
    live = LiveHypotheses()
    propose(live, source, window(observations, 5))
    for last in range(5, 12):
        carried = live.fitted(source.camera, PRIORS, window(observations, last))
    alone = hypotheses_of(source.camera, window(observations, 11), PRIORS)
    assert carried.planar == alone.planar
    rotation, direction = carried.motions[0].difference_deg(alone.motions[0])
    assert rotation < 0.1
    assert direction < 0.5
    assert carried.motions[0].fit.cost == pytest.approx(alone.motions[0].fit.cost, rel=0.02)
    assert carried.tracks.noise_px == pytest.approx(alone.tracks.noise_px, rel=0.02)
    assert is_motion_of(source, carried.motions[0], 0.5, 2)


def test_a_proposal_lives_until_no_motion_locates_the_pair():
    source = point_source("room", 0)
    observations = list(source.observations())
    live = LiveHypotheses()
    propose(live, source, window(observations, 5))
    assert live
    assert live.fitted(source.camera, PRIORS, window(observations, 5))
    assert live
    lost = [replace(view, frame=100 + view.frame, track_ids=10_000 + view.track_ids) for view in observations[:3]]
    assert live.fitted(source.camera, PRIORS, lost) is None
    assert not live


def test_a_pair_without_translation_proposes_nothing():
    source = point_source("room", 0)
    observations = list(source.observations())
    pose, rays1, rays2 = pose_of_pair(source.camera, observations[0], observations[5])
    live = LiveHypotheses()
    live.propose(replace(pose, t=np.zeros(3), alternatives=()), (0, 5), rays1, rays2, 0.7)
    assert not live


def test_a_better_motion_of_the_pair_takes_the_place_of_a_local_optimum():
    source = point_source("wall", 0, baseline=0.4)
    hypotheses = hypotheses_of(source.camera, window(list(source.observations()), 5), PRIORS)
    assert LiveHypotheses().with_better_motion(hypotheses) is None
    second = replace(hypotheses, motions=hypotheses.motions[1:])
    better = LiveHypotheses().with_better_motion(second)
    assert is_motion_of(source, better.motions[0], 1, 5)
