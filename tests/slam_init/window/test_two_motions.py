"""Laws of the tracks of a window that are taken apart by two motions."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import PRIORS, finished, hypotheses_of, looks_small, pair_and_further, point_source

from slam_init import Initializer
from slam_init.window.motion import OtherMotion
from slam_init.window.risk import risk_of
from slam_init.window.two_motions import _REST, BodySearch, without_body

MAX_RISK = 0.005


def source_of(seed, noise_px=0.3, **options):
    return point_source("room", seed, baseline=0.3, noise_px=noise_px, points=200, **options)


def hypotheses(seed, views=8, **options):
    source = source_of(seed, **options)
    return hypotheses_of(source.camera, pair_and_further(list(source.observations()), views), PRIORS)


def body(share):
    return {"moving": share, "bodies": 1, "body_turn_deg_s": 30, "outliers": 0.05}


@pytest.mark.parametrize("seed", range(2))
def test_the_tracks_that_are_left_out_lie_on_the_body_and_the_others_keep_their_motion(seed):
    options = body(0.4)
    apart = without_body(hypotheses(seed, **options))
    on_body = source_of(seed, **options).sequence.body_of_track >= 0
    assert on_body[apart.body.track_ids].mean() > 0.95
    kept = apart.tracks.track_ids[apart.motions[0].fit.explains]
    assert on_body[kept].mean() < 0.1
    assert not np.isin(apart.body.track_ids, apart.tracks.track_ids).any()


def test_a_scene_at_rest_is_not_taken_apart_however_many_outliers_there_are():
    assert without_body(hypotheses(0, outliers=0.4)) is None


@pytest.mark.filterwarnings("error")
def test_a_window_whose_tracks_follow_no_motion_is_not_taken_apart():
    """Two views have a motion, and no track follows it in the others."""
    found = hypotheses(0)
    pixels = found.tracks.pixels.copy()
    pixels[2:] += np.random.default_rng(0).normal(0, 60, pixels[2:].shape)
    assert without_body(replace(found, tracks=replace(found.tracks, pixels=pixels))) is None


def test_a_body_that_holds_most_of_the_tracks_keeps_the_risk_large_whichever_motion_is_taken_for_the_camera():
    for seed in range(2):
        apart = without_body(hypotheses(seed, **body(0.6)))
        risk = risk_of(apart, MAX_RISK)
        assert risk.other is apart.body
        assert risk.moving > MAX_RISK
        assert risk.total > MAX_RISK


def test_a_window_that_is_decided_is_not_searched_and_one_in_vain_gives_two_others_a_rest(monkeypatch):
    found, searched = hypotheses(0, **body(0.4)), []
    monkeypatch.setattr("slam_init.window.two_motions.without_body", searched.append)
    monkeypatch.setattr("slam_init.window.two_motions._shows_two_motions", lambda one: one is found)
    risk, search = risk_of(found), BodySearch()
    small, moving = looks_small(risk), replace(risk, rotation=0.0, other=OtherMotion(0.5))
    refused = replace(looks_small(risk), rival=1.0)
    for decided in (small, moving, replace(refused, rotation=0.5)):
        assert search.judge(found, decided, MAX_RISK) == (found, decided)
    rigid = hypotheses(0, outliers=0.1)
    assert search.judge(rigid, refused, MAX_RISK) == (rigid, refused)
    assert not searched
    for window in range(2 * (_REST + 1)):
        assert search.judge(found, refused, MAX_RISK) == (found, refused)
        assert len(searched) == 1 + window // (_REST + 1)


def test_a_map_of_a_window_that_is_taken_apart_has_no_landmark_on_the_body():
    source = source_of(1, noise_px=0.5, **{**body(0.3), "body_turn_deg_s": 5})
    initializer = Initializer(source.camera)
    finished(source, initializer=initializer)
    left_out = initializer._window._last.hypotheses.body.track_ids
    assert len(left_out) >= 20
    assert not np.isin(left_out, initializer.map.track_ids).any()
