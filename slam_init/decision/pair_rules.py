"""What speaks against a pair: its two views, the vote between two maps, the map itself, a camera that only turns."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from quest.estimate import RelativePose
from quest.geometry.quaternion import rotation_angle
from slam_init.bundle.problem import BundleSolution
from slam_init.config import Config
from slam_init.decision import map_gates as acceptance
from slam_init.decision.calibration_check import TurningCamera, suspected_focal_factor
from slam_init.decision.plane_vote import plane_margin
from slam_init.decision.refusal import Evidence, looked_at, refused_at, refused_by
from slam_init.frontend.keyframes import difference_gate
from slam_init.frontend.tracks import History
from slam_init.mapping.candidate import MapCandidate
from slam_init.mapping.rivals import difference_of_maps_deg, margin, same_map
from slam_init.mapping.views import table_of, voting_views
from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.frame import Observations
from slam_init.types.reasons import ACCEPTED, ADVICE, Gate
from slam_init.types.result import Attempt

__all__ = [
    "Ruling",
    "judge_map",
    "judge_turning",
    "judge_two_views",
    "suspect_calibration",
    "turning_evidence",
    "vote",
    "vote_of_plane",
]

#: A turn takes tracks farther across the lens than a short translation does, and what its calibration leaves grows with
#: the way: three times what a translation is allowed is what a lens that is calibrated to half a pixel leaves.
_TURNING_SHARED = 3.0
#: What the plane's vote must say for the maps of free points to be heard as well: odds of a thousand to one if tracks
#: err by themselves, as a logarithm, and more than one standard deviation if neighbours err alike. Of 1300 votes on
#: drawn planes, free points decided for the wrong one twice without the former, never with both.
_ODDS, _LEANS = 7.0, 1.0
#: Two maps nearer than this are nearly the same: an initialization is wrong by more. The rotation is that of the
#: direction where parallax is a tenth of a radian: the one is traded for the other.
_NEAR_ROTATION_DEG, _NEAR_DIRECTION_DEG = 1.0, 10.0


def judge_two_views(
    camera: Camera, config: Config, attempt: Attempt, pose: RelativePose, shared_turn_rad: float, spread_rad: float
) -> Attempt:
    """What two views alone refuse, before any map is built.

    Parameters
    ----------
    camera : Camera
    config : Config
    attempt : Attempt
    pose : RelativePose
    shared_turn_rad : float
        By how much errors that tracks share may turn the baseline.
    spread_rad : float
        Standard error of its direction by leaving out parts of the view (:mod:`quest.jackknife`).
    """
    if pose.kind == "rotation":
        # A rotation is fitted to noise as well, and turns by next to nothing then.
        least_px = difference_gate(max(config.map.noise_px, pose.noise_rad * camera.focal_px))
        turned = float(rotation_angle(pose.R)) * camera.focal_px
        gate = Gate("turned_px", turned, least_px, True, "static_camera", ADVICE["static_camera"])
        attempt = looked_at(attempt, (gate,))
        if not gate.passes():
            return refused_by(attempt, "motion", (gate,))
        return refused_at(attempt, "pure_rotation", "motion")
    settings = config.acceptance
    # Further views and the adjustment bring the uncertainty down by about the square root of their number: a pair
    # whose single standard deviation is beyond what three of the map may be is too early by far.
    sigma_deg = float(np.degrees(pose.direction_sigma_rad))
    most_deg, least_share = settings.max_direction_error_deg, config.two_view.min_inlier_share
    by_noise = (
        Gate(
            "inlier_share",
            float(pose.inliers.mean()),
            least_share,
            True,
            "no_consistent_motion",
            ADVICE["no_consistent_motion"],
        ),
        Gate("two_view_direction_sigma_deg", sigma_deg, most_deg, False, "low_parallax", ADVICE["low_parallax"]),
        Gate(
            "direction_shared_deg",
            float(np.degrees(shared_turn_rad)),
            most_deg,
            False,
            "low_parallax",
            "translate further: what is seen could nearly be a rotation",
        ),
    )
    spread = Gate(
        "direction_spread_deg",
        min(3 * float(np.degrees(spread_rad)), 180.0),
        most_deg,
        False,
        "low_parallax",
        "parts of the view disagree on the direction of motion: translate further, and look at what stands still",
    )
    gates = (*by_noise, spread)
    attempt = looked_at(attempt, gates)
    if all(gate.passes() for gate in gates):
        return attempt
    refused = refused_by(attempt, "two views", gates)
    if refused.verdict != "low_parallax":
        return refused
    # What the noise lacks foretells how much longer the way has to be; a spread of a dozen fits jumps.
    return replace(refused, lacking=max(gate.lacking() for gate in by_noise))


# -- the vote -------------------------------------------------------------------------------------


def vote_of_plane(
    config: Config,
    history: History,
    reference: Observations,
    current: Observations,
    pose: RelativePose,
    candidates: list[MapCandidate],
) -> Margin | None:
    """The vote of all views between the two maps of a plane, with the plane as a constraint."""
    solved = [c for c in candidates if isinstance(c.bundle, BundleSolution)]
    if pose.kind != "planar" or len(solved) != 2 or same_map(*solved):
        return None
    voters = table_of(reference, current, voting_views(history, reference, current, config.map))
    return plane_margin(voters, solved[0].hypothesis, solved[1].hypothesis, pose.noise_rad)


class Ruling(NamedTuple):
    """What the votes between the best map and its rivals came to.

    Attributes
    ----------
    margin : Margin or None
        The one that the verdict hangs on: of the rival that came nearest, and of its votes the clearest, or the one
        that speaks against the best map. None where no rival had to be beaten.
    rival : MapCandidate or None
        That rival.
    near_deg : float
        How far the baselines of the nearly equal maps are that could not be ruled out.
    """

    margin: Margin | None
    rival: MapCandidate | None
    near_deg: float


def vote(
    camera: Camera, config: Config, attempt: Attempt, candidates: list[MapCandidate], plane: Margin | None
) -> tuple[Attempt, Ruling]:
    """Whether the best map is better than each of its rivals, beyond doubt: as free points, or as a plane.

    A rival that is nearly the same map need not be beaten: were it the right one, the best would be off by about what
    lies between them, and so much is added to the bound of its direction.
    """
    best, *rivals = candidates
    evidence = dict(attempt.evidence)
    votes: list[tuple[Margin, MapCandidate]] = []
    near_deg = 0.0
    for k, rival in enumerate(rivals, start=1):
        if same_map(best, rival):
            continue
        free = margin(camera, config, best, rival)
        evidence |= {f"rival{k}_log_likelihood": free.log_likelihood, f"rival{k}_z": free.z}
        margins = [free]
        if k == 1 and plane is not None:
            evidence |= {"plane_log_likelihood": plane.log_likelihood, "plane_z": plane.z}
            # Maps of free points are hard to adjust under a wrong motion, and one that ended in a bad optimum votes for
            # its rival. They are believed where the plane, whose points cannot give way, says the same at long odds.
            margins = [free, plane] if plane.log_likelihood > _ODDS and plane.z > _LEANS else [plane]
        against = [m for m in margins if m.reversed().decides()]
        clearest = min(against or [max(margins, key=Margin.share)], key=Margin.share)
        rotation_deg, direction_deg = difference_of_maps_deg(best, rival)
        near = rotation_deg < _NEAR_ROTATION_DEG and direction_deg < _NEAR_DIRECTION_DEG
        if near and not against and not clearest.decides():
            near_deg = max(near_deg, direction_deg)
            evidence["near_rival_deg"] = near_deg
        else:
            votes.append((clearest, rival))
    if not votes:
        return replace(attempt, evidence=evidence), Ruling(None, None, near_deg)
    chosen, closest = min(votes, key=lambda one: one[0].share())
    curve = "scene too flat: move in a curve, or show something off the plane"
    gates = (
        Gate("vote_z", chosen.z, chosen.z_needed, True, "ambiguous_plane", curve),
        Gate(
            "vote_log_likelihood",
            chosen.log_likelihood,
            Margin.LOG_LIKELIHOOD_NEEDED,
            True,
            "ambiguous_plane",
            curve,
        ),
    )
    attempt = looked_at(replace(attempt, evidence=evidence), gates)
    return (attempt if chosen.decides() else refused_by(attempt, "map", gates)), Ruling(chosen, closest, near_deg)


# -- the map --------------------------------------------------------------------------------------


def judge_map(
    camera: Camera,
    config: Config,
    attempt: Attempt,
    best: MapCandidate,
    bundle: BundleSolution,
    shared_turn_rad: float,
    near_deg: float,
    third_view: bool,
) -> Attempt:
    """The gates of the acceptance; without a third view those that ask for one are passed over."""
    verdict, gates = acceptance.check(camera, best, bundle, shared_turn_rad, near_deg, config.acceptance)
    attempt = looked_at(attempt, gates)
    attempt = replace(
        attempt,
        evidence=attempt.evidence | {"reprojection_rmse_px": bundle.rmse_px},
        lacking=max(gate.lacking() for gate in gates),
    )
    if verdict == ACCEPTED or (verdict == "no_third_view" and not third_view):
        return attempt
    return refused_by(attempt, "map", gates)


def judge_turning(
    camera: Camera, config: Config, attempt: Attempt, turning: TurningCamera, noise_rad: float, shared_rad: float
) -> Attempt:
    """Refuse a map where a turning camera with another focal length explains the matches as well."""
    residual = turning.residual_rad / _turning_rad(camera, config, turning, noise_rad, shared_rad)
    needed = config.acceptance.min_turning_residual
    gate = Gate("turning_residual", residual, needed, True, "pure_rotation", _turning_advice(turning))
    attempt = looked_at(attempt, (gate,))
    evidence = turning_evidence(camera, config, turning, noise_rad, shared_rad)
    attempt = replace(attempt, evidence=attempt.evidence | evidence)
    if gate.passes():
        return attempt
    return refused_by(replace(attempt, lacking=needed / residual), "map", (gate,))


def suspect_calibration(
    camera: Camera, config: Config, attempt: Attempt, pose: RelativePose, turning: TurningCamera, shared_rad: float
) -> Attempt:
    """A refused pair; refused as a turning camera where one with another focal length explains a plane's matches.

    Only a plane's: what such a camera shows is a homography.
    """
    if pose.kind != "planar":
        return attempt
    evidence = turning_evidence(camera, config, turning, pose.noise_rad, shared_rad)
    attempt = replace(attempt, evidence=attempt.evidence | evidence)
    if "suspected_focal_factor" not in evidence:
        return attempt
    return replace(attempt, verdict="pure_rotation", advice=_turning_advice(turning))


def turning_evidence(
    camera: Camera, config: Config, turning: TurningCamera, noise_rad: float, shared_rad: float
) -> Evidence:
    """The focal length that a turning camera would have, and whether the stated one is suspected to be wrong."""
    evidence: Evidence = {"turning_focal_factor": turning.focal_factor}
    most_rad = config.acceptance.min_turning_residual * _turning_rad(camera, config, turning, noise_rad, shared_rad)
    suspected = suspected_focal_factor(turning, most_rad)
    return evidence if suspected is None else evidence | {"suspected_focal_factor": suspected}


def _turning_rad(camera: Camera, config: Config, turning: TurningCamera, noise_rad: float, shared_rad: float) -> float:
    """What a camera that does turn may leave of the matches: the noise, what tracks share, and chance."""
    noise_rad = max(noise_rad, config.map.min_noise_px / camera.focal_px)
    return turning.chance_factor * float(np.hypot(noise_rad, _TURNING_SHARED * shared_rad))


def _turning_advice(turning: TurningCamera) -> str:
    return (
        f"a camera that only turns, with {turning.focal_factor:.2f} times the stated focal length, shows the same: "
        "translate sideways, or check the calibration"
    )
