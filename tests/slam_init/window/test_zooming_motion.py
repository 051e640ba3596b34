"""Laws of a camera that moves while its lens zooms: the zooms are found, and cost nothing where there are none."""

from dataclasses import replace

import make_window
import numpy as np
import pytest
from make_window import hypotheses_of_changing_lens as hypotheses
from make_window import looks_small

from slam_init.window import zooming_motion
from slam_init.window.joint_fit import fit_window
from slam_init.window.last_look import after_last_look
from slam_init.window.risk import risk_of
from slam_init.window.zooming_motion import wrong_by_zooms, zooming_motions
from slam_init.window.zooming_rotation import with_zooms, zoomed


def test_the_zooms_of_a_moving_camera_are_found():
    ramp = -0.2
    found = hypotheses("desk", 1, ramp=ramp, baseline=0.1)
    best = max(zooming_motions(found, with_zooms(found)), key=lambda one: one.log_evidence)
    frames = np.array(found.motions[0].frames) - found.motions[0].frames[0]
    assert best.log_evidence > 50
    assert np.abs(best.zooms - ramp * frames / frames.max()).max() < 0.02


@pytest.mark.parametrize(("scene", "seed"), [("wall", 1), ("desk", 1)])
def test_a_lens_that_does_not_zoom_adds_nothing_to_the_risk(scene, seed):
    found = hypotheses(scene, seed, baseline=0.1)
    assert wrong_by_zooms(found, with_zooms(found)) < 0.001


def test_no_map_of_a_zooming_lens_is_confirmed():
    """Unless the lens is said to be fixed."""
    found = hypotheses("desk", 1, ramp=-0.2, baseline=0.1)
    small = looks_small(risk_of(found))
    assert after_last_look(found, small, max_risk=1.0)[1].direction > 0.99
    fixed = replace(found, priors=replace(found.priors, lens_changes=0.0))
    assert after_last_look(fixed, small, max_risk=1.0)[1].direction < 0.99


def test_what_cannot_be_told_from_a_zoom_keeps_the_probability_of_one():
    """Level flight at a short baseline: a zoom moves the tracks as a climb does, so that its evidence is near 0."""
    found = hypotheses("nadir", 2, baseline=0.05, points=300)
    motions = list(zooming_motions(found, with_zooms(found)))
    assert -12 < max(one.log_evidence for one in motions) < 1
    assert max(one.direction_sigma_deg for one in motions) > 15


def test_the_zoom_of_a_second_view_alone_refuses_no_map_whose_direction_it_leaves(monkeypatch):
    monkeypatch.setattr(make_window, "VIEWS_OF_CHANGING_LENS", 2)
    found = hypotheses("room", 1, ramp=0.05, baseline=0.4, points=300)
    told = max(zooming_motions(found, with_zooms(found)), key=lambda one: one.log_evidence)
    assert abs(told.zooms[1]) > 0.04 and told.direction_sigma_deg < 1
    assert wrong_by_zooms(found, with_zooms(found)) < 1e-3


def test_each_start_costs_what_its_tracks_cost_with_its_zooms_undone_and_nothing_else():
    """Before a plane the camera that only rotates shifts its images too, which the motion does not.

    A fit that has not converged is off by a thousandth, and shifts double the cost.
    """
    found = hypotheses("wall", 1, ramp=0.02, baseline=0.1, points=300)
    rotation = with_zooms(found)
    assert np.abs(rotation.shifts).max() > 1
    for tracks, fit, zooms in zooming_motion._starts(found, found.motions[0].fit, rotation):
        again = fit_window(zoomed(tracks, zooms), fit.state, found.priors, max_steps=0)
        assert again.cost == pytest.approx(fit.cost, rel=0.01)


def test_a_better_mode_of_the_motion_is_no_evidence_of_zooms(monkeypatch):
    """The fit without zooms is in a mode that is worse by 20 nats, and the zooms leave it."""
    found = hypotheses("room", 2, baseline=0.1)
    rotation, state = with_zooms(found), found.motions[0].fit.state

    def in_a_worse_mode(tracks, start, priors, max_steps):
        fit = fit_window(tracks, start, priors, max_steps=max_steps)
        return replace(fit, cost=fit.cost + 40) if start is state else fit

    evidence = max(one.log_evidence for one in zooming_motions(found, rotation))
    monkeypatch.setattr(zooming_motion, "fit_window", in_a_worse_mode)
    assert max(one.log_evidence for one in zooming_motions(found, rotation)) < evidence + 1
