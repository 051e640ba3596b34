"""Laws of the hypotheses that live: frames carry them, and the number of motions stays bounded."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from make_window import PRIORS, hypotheses_of, point_source, pose_errors_deg, pose_of_pair, true_motion

from quest import Hypothesis
from quest.geometry.quaternion import quaternion_from_matrix, rotation_from_vector
from slam_init.window import live as live_module
from slam_init.window.live import LiveHypotheses


def window(observations, last, reference=0):
    """Reference, current, and the frames between."""
    return [observations[reference], observations[last], *observations[reference + 1 : last]]


def propose(live, source, views):
    pose, rays1, rays2 = pose_of_pair(source.camera, *views[:2])
    live.propose(pose, (views[0].frame, views[1].frame), rays1, rays2, 0.7)
    return pose


# -- real fits ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scene", "seed", "baseline"), [("room", 0, 0.15), ("wall", 2, 0.3)])
def test_a_carried_motion_is_that_of_the_last_window_fitted_from_its_own_pair(scene, baseline, seed):
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
    errors = pose_errors_deg(carried.motions[0].cam2_from_cam1, true_motion(source, 0, 11))
    assert errors[0] < 0.5
    assert errors[1] < 2


def test_a_motion_is_carried_to_another_reference():
    source = point_source("room", 2)
    observations = list(source.observations())
    live = LiveHypotheses()
    propose(live, source, window(observations, 8))
    assert live.fitted(source.camera, PRIORS, window(observations, 8))
    carried = live.fitted(source.camera, PRIORS, window(observations, 11, reference=3))
    assert carried.motions[0].frames[:2] == (3, 11)
    rotation, direction = pose_errors_deg(carried.motions[0].cam2_from_cam1, true_motion(source, 3, 11))
    assert rotation < 0.5
    assert direction < 3


def test_further_views_drop_the_twin_of_a_plane():
    source = point_source("wall", 0, baseline=0.4)
    observations = list(source.observations())
    live = LiveHypotheses()
    propose(live, source, [observations[0], observations[5]])
    counts = [len(live.fitted(source.camera, PRIORS, [observations[0], observations[5]]).motions)]
    for last in range(6, 12):
        counts.append(len(live.fitted(source.camera, PRIORS, window(observations, last)).motions))
    assert counts[0] == 2
    assert counts[-1] == 1


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


# -- the choice of motions, with fits of given costs ------------------------------------------------


#: Gain over the rotation-only camera (nats) and its degrees of freedom.
FAR_FROM_ROTATION = (1000.0, 10.0)


def votes_by_costs(motion, rival):
    """The votes where no track has more than its largest one."""
    return np.array([rival.fit.cost - motion.fit.cost])


class GivenCosts:
    """Stands for the fits: every motion keeps its poses, in the order and with the costs and views that are given."""

    def __init__(self):
        self.asked, self.costs, self.views = [], {}, {}
        self.gain_over_rotation = FAR_FROM_ROTATION

    def __call__(self, tracks, motions, priors, living):
        self.asked.append(motions)
        fits = [
            SimpleNamespace(
                motion=motion,
                rows=tuple(range(self.views.get(k, 3))),
                fit=SimpleNamespace(cost=self.costs.get(k, 100.0 + k)),
                is_new=False,
            )
            for k, motion in enumerate(motions)
        ]
        fits.sort(key=lambda fitted: (-len(fitted.rows), fitted.fit.cost))
        if not fits:
            return None
        return SimpleNamespace(
            tracks=tracks,
            motions=tuple(fits),
            gain_over_rotation=self.gain_over_rotation,
            votes=votes_by_costs,
            rotations=(),
            body=None,
        )


@pytest.fixture
def fits(monkeypatch):
    given = GivenCosts()
    monkeypatch.setattr(live_module, "fit_hypotheses", given)
    return given


@pytest.fixture(scope="module")
def pair():
    """A room, three of its frames and the pose of the first two."""
    source = point_source("room", 1)
    observations = list(source.observations())
    views = window(observations, 6)[:3]
    return source, views, pose_of_pair(source.camera, *views[:2])


def about(pose, deg):
    """The hypothesis whose rotation differs by an angle."""
    R = rotation_from_vector(np.radians([0, 0, deg])) @ pose.R
    return Hypothesis(quaternion_from_matrix(R), R, pose.t, pose.inliers)


def proposal(live, pair, degs, frames=None):
    """Propose the pose of the pair and poses whose rotation differs from it."""
    _, views, (pose, rays1, rays2) = pair
    first, *others = (about(pose, deg) for deg in degs)
    changed = replace(pose, q_wxyz=first.q_wxyz, R=first.R, alternatives=tuple(others), kind="general")
    live.propose(changed, frames or (views[0].frame, views[1].frame), rays1, rays2, 0.7)


def poses_of(motions):
    """The poses of motions, to be compared by their identity."""
    return [id(motion.cam_from_world) for motion in motions]


def test_living_motions_come_before_the_proposals(pair, fits):
    """A later motion that is near an earlier one is not fitted, and living motions know more views."""
    live = LiveHypotheses()
    for degs in ([0], [20]):
        proposal(live, pair, degs)
        live.fitted(pair[0].camera, PRIORS, pair[1])
    assert len(fits.asked[1]) == 2
    assert poses_of(fits.asked[1][:1]) == poses_of(fits.asked[0])
    assert [one.is_new for one in fits.asked[1]] == [False, True]


def test_a_proposal_of_a_pair_that_no_motion_knows_is_new(pair, fits):
    live = LiveHypotheses()
    proposal(live, pair, [0])
    live.fitted(pair[0].camera, PRIORS, pair[1])
    proposal(live, pair, [0], frames=(50, 51))
    live.fitted(pair[0].camera, PRIORS, pair[1])
    assert [len(motions) for motions in fits.asked] == [1, 2]


def test_hopeless_motions_are_dropped(pair, fits):
    live = LiveHypotheses()
    proposal(live, pair, [0, 20, 40])
    fits.costs = {0: 1000.0, 1: 1199.0, 2: 1201.0}
    live.fitted(pair[0].camera, PRIORS, pair[1])
    live.fitted(pair[0].camera, PRIORS, pair[1])
    assert poses_of(fits.asked[1]) == poses_of(fits.asked[0][:2])


def test_a_few_tracks_that_are_far_off_do_not_drop_a_motion(pair, fits, monkeypatch):
    """Tracks on a moving body: each costs a rival as much as it is off, and votes by no more than an outlier."""
    live = LiveHypotheses()
    proposal(live, pair, [0, 20])
    fits.costs = {0: 1000.0, 1: 5000.0}
    monkeypatch.setattr(sys.modules[__name__], "votes_by_costs", lambda motion, rival: np.full(20, 6.0))
    live.fitted(pair[0].camera, PRIORS, pair[1])
    live.fitted(pair[0].camera, PRIORS, pair[1])
    assert len(fits.asked[1]) == 2


@pytest.mark.parametrize(("gain", "lives"), [(4.9, False), (5.1, True)])
def test_motions_that_gain_no_more_than_chance_over_a_rotation_are_not_carried(pair, fits, gain, lives):
    live = LiveHypotheses()
    proposal(live, pair, [0, 20])
    fits.gain_over_rotation = (gain, 10.0)
    assert len(live.fitted(pair[0].camera, PRIORS, pair[1]).motions) == 2
    assert bool(live) == lives


def test_the_four_best_motions_live(pair, fits):
    live = LiveHypotheses()
    proposal(live, pair, [0, 20, 40, 60, 80, 100])
    fits.costs = dict(enumerate([60.0, 50.0, 40.0, 30.0, 20.0, 10.0]))
    live.fitted(pair[0].camera, PRIORS, pair[1])
    live.fitted(pair[0].camera, PRIORS, pair[1])
    assert poses_of(fits.asked[1]) == poses_of(fits.asked[0][:1:-1])
