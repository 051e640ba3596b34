"""The last look at a map whose risk is small: at rivals that take a search of their own, in turn while it stays small.

1. The camera that only rotates is fitted from afar, and to the half of the tracks that it explains best: bodies may
   hold the others (:mod:`~slam_init.window.half_at_rest`).
2. Its images may zoom and shift from view to view (:mod:`~slam_init.window.zooming_rotation`).
3. All motions are fitted with free depths, and motions are tried that no pair proposed
   (:mod:`~slam_init.window.second_look`).
4. The motion is fitted to each half of the view: a body may hold it (:mod:`~slam_init.window.left_out`).
5. The moving camera may zoom (:mod:`~slam_init.window.zooming_motion`).

They take most of the time of the frame that brings a map. A frame that waits pays for them only where its risk is small
and one of them refuses it.
"""

from __future__ import annotations

from dataclasses import replace

from quest.noise import GATE_SIGMAS
from slam_init.system.linear_algebra import single_threaded
from slam_init.window.half_at_rest import bodies_probability
from slam_init.window.hypotheses import WindowHypotheses, with_plane, with_rotation_anew
from slam_init.window.left_out import wrong_by_a_half
from slam_init.window.levels import ON_BODIES, SAME_DIRECTION_DEG, SAME_ROTATION_DEG, UNDECIDED
from slam_init.window.motion import fit_motion
from slam_init.window.other_motion import bearings_of_best
from slam_init.window.risk import WindowRisk, directions_and_rival, risk_of, with_rotation_of
from slam_init.window.rival import rival_term
from slam_init.window.rotation_term import with_errors_in_noise, zooming_probability
from slam_init.window.second_look import look_again
from slam_init.window.uncertainty import expand
from slam_init.window.zooming_motion import wrong_by_zooms
from slam_init.window.zooming_rotation import ZoomingRotation, with_zooms


def after_last_look(
    hypotheses: WindowHypotheses, risk: WindowRisk, max_risk: float
) -> tuple[WindowHypotheses, WindowRisk]:
    """Hypotheses whose risk is small, and the risk after a second look at them; others are returned as they are."""
    if risk.total > max_risk:
        return hypotheses, risk
    with single_threaded():
        if hypotheses.rotation_lives:  # a start near its last fit may have kept it in a wrong mode
            anew = with_rotation_anew(hypotheses)
            if anew is not hypotheses:
                hypotheses, risk = anew, with_rotation_of(anew, risk)
                if risk.total > max_risk:
                    return hypotheses, risk
        risk = _against_bodies(hypotheses, risk)
        if risk.total > max_risk:
            return hypotheses, risk
        rotation = with_zooms(hypotheses)
        risk = _against_zooming_rotation(hypotheses, risk, rotation)
        if risk.total > max_risk:
            return hypotheses, risk
        free = look_again(hypotheses)
        hypotheses, risk = _with_free_depths(hypotheses, risk, free)
        if risk.total <= max_risk:
            risk = _against_a_half(hypotheses, risk)
        if risk.total > max_risk or not hypotheses.priors.lens_changes:
            return hypotheses, risk
        direction = min(1.0, risk.direction + wrong_by_zooms(hypotheses, rotation))
        return hypotheses, replace(risk, direction=direction)


def _with_free_depths(
    hypotheses: WindowHypotheses, risk: WindowRisk, free: WindowHypotheses
) -> tuple[WindowHypotheses, WindowRisk]:
    """The hypotheses to go on with after a second look with free depths, and their risk.

    The plane keeps its precision where the fits with free depths agree on the motion, and decide against all rivals.
    """
    best, again = hypotheses.motions[0], free.motions[0]
    if not hypotheses.planar:
        if not again.same_as(best):
            return free, risk_of(free)
        if len(free.motions) == 1:
            return hypotheses, risk
        # The best motion is the same, and so are its terms: further starts and more steps change its rivals alone.
        rival, nearest = rival_term(free, expand(again), risk.directions.sigma_deg, most=UNDECIDED)
        return free, replace(risk, rival=rival, margin=nearest)
    # The scene must not vote for a motion: points that leave one of two planes vote by their free depths.
    planes, deg = _on_planes(hypotheses, free), risk.directions.sigma_deg
    by_points, _ = rival_term(planes, expand(best), deg, most=UNDECIDED, free=free)
    known = [one for one in free.motions[1:] if planes.fit_near(one)]
    of_free, of_rival = directions_and_rival(
        replace(free, motions=tuple(one for one in free.motions if one not in known))
    )
    rotation_deg, direction_deg = best.difference_deg(again)
    near = rotation_deg <= GATE_SIGMAS * of_free.rotation_sigma_deg + SAME_ROTATION_DEG
    if not near or direction_deg > GATE_SIGMAS * of_free.sigma_deg + SAME_DIRECTION_DEG:
        return free, risk_of(free)
    rival, direction = min(1.0, max(risk.rival, by_points) + of_rival), risk.direction
    # The plane of shifted frames is another one in each view, so that it tells nothing about the direction.
    direction = max(direction, risk.directions.frames_are_shifted * of_free.of_pair)
    return hypotheses, replace(risk, rival=rival, direction=direction)


def _on_planes(hypotheses: WindowHypotheses, free: WindowHypotheses) -> WindowHypotheses:
    """Hypotheses on a plane, with the motions that only free depths have found."""
    tracks, bearings = hypotheses.tracks, bearings_of_best(hypotheses)
    new = [replace(one.motion, points=None) for one in free.motions[1:] if hypotheses.fit_near(one) is None]
    fits = [fit_motion(tracks, with_plane(one, tracks, bearings), hypotheses.priors) for one in new]
    return replace(hypotheses, motions=(*hypotheses.motions, *fits))


def _against_bodies(hypotheses: WindowHypotheses, risk: WindowRisk) -> WindowRisk:
    """The risk with the rival that the camera only rotates as half of the tracks say, and that the others move."""
    rotation = risk.rotation
    for one in () if hypotheses.planar else (hypotheses, *_wide_too(hypotheses, risk)):
        rotation = max(rotation, bodies_probability(one, ON_BODIES, anew=True))
    return replace(risk, rotation=rotation)


def _against_a_half(hypotheses: WindowHypotheses, risk: WindowRisk) -> WindowRisk:
    """The risk with the rival that a body on one half of the view holds the best motion."""
    return replace(risk, by_a_half=wrong_by_a_half(hypotheses))


def _against_zooming_rotation(hypotheses: WindowHypotheses, risk: WindowRisk, zooming: ZoomingRotation) -> WindowRisk:
    """The risk with the rival that the camera only rotates, and that its images zoom and shift from view to view."""
    return replace(risk, rotation=risk.rotation + zooming_probability(hypotheses, zooming))


def _wide_too(hypotheses: WindowHypotheses, risk: WindowRisk) -> tuple[WindowHypotheses, ...]:
    return (with_errors_in_noise(hypotheses),) if risk.lasting_in_noise else ()
