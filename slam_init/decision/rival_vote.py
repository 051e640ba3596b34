"""Decision rules for rival maps, as on a plane: the best map has to explain the tracks better than each rival.

The stages of :mod:`slam_init.attempt` work in this order:

1. :func:`slam_init.mapping.rivals.rank` sorts the candidate maps, the best first.
2. :func:`vote_of_plane` lets all views vote between the two maps of a plane. It calls
   :func:`slam_init.decision.plane_vote.plane_margin`, which adjusts the model of :mod:`slam_init.decision.plane_model`
   for each motion. If this vote decides for the second map, the two maps are exchanged.
3. :func:`vote_on_rivals` compares the best map with each rival as free points, by
   :func:`slam_init.mapping.rivals.margin`, adds the vote with the plane as a constraint, and chooses the deciding vote.
4. :func:`vote_gates` makes the two gates of the deciding vote.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from quest.estimate import RelativePose
from slam_init.bundle.problem import BundleSolution
from slam_init.config import Config
from slam_init.decision.plane_vote import plane_margin
from slam_init.frontend.tracks import History
from slam_init.mapping.candidate import MapCandidate
from slam_init.mapping.rivals import difference_of_maps_deg, margin, same_map
from slam_init.mapping.views import table_of, voting_views
from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.evidence import RivalVote, VoteEvidence
from slam_init.types.frame import Observations
from slam_init.types.gates import Gate, GateName, at_least
from slam_init.types.reasons import Verdict

__all__ = ["VoteOutcome", "vote_gates", "vote_of_plane", "vote_on_rivals"]

#: The vote between maps of free points counts only if the vote with the plane as a constraint is clear: odds of 1000 to
#: 1 (as a logarithm) if the errors of tracks are independent, and more than one standard deviation if the errors of
#: neighbours are correlated. Of 1300 votes on drawn planes, free points decided for the wrong map twice without the
#: first condition, and never with both.
_PLANE_LOG_ODDS, _PLANE_Z = 7.0, 1.0
#: Two maps that differ by less than both angles count as nearly equal, since an initialization is wrong only beyond 5
#: degrees in rotation and 15 degrees in direction. At a parallax of 0.1 rad, a direction error of 10 degrees moves the
#: tracks as much as a rotation error of 0.1 x 10 = 1 degree. Hence the bound of 1 degree.
_NEAR_ROTATION_DEG, _NEAR_DIRECTION_DEG = 1.0, 10.0
_CURVE = "scene too flat: move in a curve, or show something off the plane"


class VoteOutcome(NamedTuple):
    """The votes between the best map and its rivals, and the rival of the deciding vote.

    Attributes
    ----------
    evidence : VoteEvidence
    nearest : MapCandidate or None
        The rival of the deciding vote: the rival over which the best map has the smallest advantage, negative if the
        rival is better. None where no rival had to be beaten.
    """

    evidence: VoteEvidence
    nearest: MapCandidate | None


def vote_of_plane(
    config: Config,
    history: History,
    reference: Observations,
    current: Observations,
    pose: RelativePose,
    candidates: Sequence[MapCandidate],
) -> Margin | None:
    """Let all views vote between the two maps of a plane, with the plane as a constraint.

    Parameters
    ----------
    config : Config
    history : History
        Holds the views that may vote.
    reference, current : Observations
        The pair.
    pose : RelativePose
        Of the pair.
    candidates : sequence of MapCandidate
        The best first.

    Returns
    -------
    Margin or None
        How much better the first adjusted candidate is than the second one. None where the scene is not planar, where
        there are not two different adjusted maps, or where no further view sees the plane.
    """
    solved = [c for c in candidates if isinstance(c.bundle, BundleSolution)]
    if pose.kind != "planar" or len(solved) != 2 or same_map(*solved):
        return None
    voters = table_of(reference, current, voting_views(history, reference, current, config.map))
    return plane_margin(voters, solved[0].hypothesis, solved[1].hypothesis, pose.noise_rad)


def vote_on_rivals(camera: Camera, candidates: Sequence[MapCandidate], plane: Margin | None) -> VoteOutcome:
    """Compare the best map with each of its rivals: as free points, and as a plane where there is such a vote.

    A rival that is nearly equal to the best map need not be beaten if no vote decides between the two. If this rival
    were right, the error of the best map would be about the difference of the two maps. This difference is added to the
    bound of the direction error.

    Parameters
    ----------
    camera : Camera
    candidates : sequence of MapCandidate
        The best map first; the others are its rivals.
    plane : Margin or None
        Of :func:`vote_of_plane`.

    Returns
    -------
    VoteOutcome
    """
    best, *rivals = candidates
    free_votes: list[RivalVote] = []
    votes: list[tuple[Margin, MapCandidate]] = []
    plane_used: Margin | None = None
    near_deg = 0.0
    for k, rival in enumerate(rivals, start=1):
        if same_map(best, rival):
            continue
        free = margin(camera, best, rival)
        free_votes.append(RivalVote(k, free.log_likelihood, free.z))
        margins = [free]
        if k == 1 and plane is not None:
            plane_used = plane
            margins = _with_plane(free, plane)
        # ``clearest`` is the vote most strongly against the best map, if any decides against it; otherwise it is the
        # strongest vote for the best map.
        against = [m for m in margins if m.reversed().decides()]
        clearest = min(against or [max(margins, key=Margin.decision_ratio)], key=Margin.decision_ratio)
        rotation_deg, direction_deg = difference_of_maps_deg(best, rival)
        near = rotation_deg < _NEAR_ROTATION_DEG and direction_deg < _NEAR_DIRECTION_DEG
        if near and not against and not clearest.decides():
            near_deg = max(near_deg, direction_deg)
        else:
            votes.append((clearest, rival))
    deciding, nearest = min(votes, key=lambda one: one[0].decision_ratio()) if votes else (None, None)
    return VoteOutcome(VoteEvidence(tuple(free_votes), plane_used, deciding, near_deg), nearest)


def _with_plane(free: Margin, plane: Margin) -> list[Margin]:
    """Return the votes that count on a plane.

    A map of free points is hard to adjust under a wrong motion. A map that ended in a bad optimum votes for its rival.
    So the vote of free points counts only if the vote with the plane as a constraint, where no point can leave the
    plane, prefers the same map by a wide margin.
    """
    clear = plane.log_likelihood > _PLANE_LOG_ODDS and plane.z > _PLANE_Z
    return [free, plane] if clear else [plane]


def vote_gates(deciding: Margin) -> tuple[Gate, Gate]:
    """Make the two gates of a vote.

    Parameters
    ----------
    deciding : Margin

    Returns
    -------
    tuple of two Gate
        Both pass where the vote decides for the best map.
    """
    ambiguous = Verdict.AMBIGUOUS_PLANE
    needed = Margin.LOG_LIKELIHOOD_NEEDED
    return (
        at_least(GateName.VOTE_Z, deciding.z, deciding.z_needed, ambiguous, _CURVE),
        at_least(GateName.VOTE_LOG_LIKELIHOOD, deciding.log_likelihood, needed, ambiguous, _CURVE),
    )
