"""The risk that a map from anywhere is wrong: its poses are one motion among those that explain the tracks.

The tracks and further views make a window, as for a map of our own. Its hypotheses are the motions that quest proposes
from the pair, the motion of the map, and the camera that only rotates. The risk of the map is its probability to be
wrong over all of them (:mod:`slam_init.auditing.posterior`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from quest.estimate import RelativePose
from slam_init.auditing.posterior import MapPosterior, is_near, posterior_of
from slam_init.config import Config
from slam_init.decision.evaluated_window import EvaluatedWindow, WindowViews
from slam_init.decision.lens import priors_of
from slam_init.decision.two_views import MatchedPair, pose_at_fitting_threshold
from slam_init.errors import ConfigError, SlamInitError, check_type
from slam_init.frontend.checks import check_rays
from slam_init.frontend.keyframes import PairPreview, preview_pairs
from slam_init.mapping.views import further_views
from slam_init.system.linear_algebra import single_threaded
from slam_init.types.arrays import as_array, evenly_spaced
from slam_init.types.audit import Audit, AuditVerdict
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.history import History
from slam_init.types.initial_map import UNMODELLED_RISK
from slam_init.types.lens import CurrentLens
from slam_init.types.pose import Pose
from slam_init.types.refusal import Verdict
from slam_init.window.hypotheses import fit_hypotheses, motions_of_pair
from slam_init.window.levels import SHORTEST_BASELINE
from slam_init.window.motion import Motion
from slam_init.window.risk import risk_of, with_zooming_rotation
from slam_init.window.tracks import MAX_VIEWS, gather_tracks

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

#: Cameras nearer to each other than this share of their distance from the origin are at one place: rounding.
#: Class: geometry.
_ONE_PLACE = 1e-9
#: Pairs are chosen among so many frames with a pose: 276 pairs take a second.
#: Class: budget.
_MOST_FRAMES = 24
#: Views after the pair see the same scene while they share this part of its tracks. Tracks drift: with views far
#: beyond the baseline of the pair the drift looks like moving objects. Of 32 right maps at 17 starts of four films 10
#: were sound with a share of .3, 14 with .5, 16 with .7, and 14 without such views.
#: Class: measured.
_SAME_SCENE = 0.7
#: A map is wrong at odds of nine to one. Even odds are no contradiction: the two motions of a plane, and two rigid
#: motions of the scene, have a half each where the tracks do not decide.
#: Class: level.
WRONG = 0.9
_AT_A_DISTANCE = "the poses are away from the best motion: adjust the map with all of its tracks and views"
_ANOTHER_MOTION = "another motion explains the tracks better: initialize again, or start from the better motion"


def audit(
    poses: Mapping[int, Pose | ArrayLike],
    tracks: Iterable[Observations],
    camera: Camera,
    config: Config | None = None,
) -> Audit:
    """State the risk that a map from anywhere is wrong.

    Parameters
    ----------
    poses : mapping of int to Pose or (4, 4) array_like
        ``world_from_cam`` of two frames or more, by the index of the frame, in any world and unit.
    tracks : iterable of Observations
        The tracks of these frames, and of further ones if there are any: views without a pose help to decide, most of
        all where the scene is flat. They must not be chosen by the map: if its outliers are left out, less speaks
        against it.
    camera : Camera
        The calibration of the images; ``focal_sigma`` where the focal length is an estimate.
    config : Config, optional

    Returns
    -------
    Audit
        Truthy for a sound map.

    Raises
    ------
    SlamInitError
        If fewer than two frames have a pose and tracks, a pose is no rigid transformation, all cameras are at one
        place, or no two frames with a pose share enough tracks. The message is one line.
    """
    config = Config() if config is None else config
    check_type(config, Config, "the configuration", "slam_init.Config, or load_config(FILE)", ConfigError)
    check_type(camera, Camera, "the camera", "a Camera (Camera.from_K)")
    check_type(poses, Mapping, "the mapping of poses", "world_from_cam as a dict by frame")
    check_type(tracks, Iterable, "the sequence of tracks", "slam_init.Observations, one for each frame")
    for frame in poses:
        check_type(frame, (int, np.integer), "the frame of a pose", "its index, an integer")
    known = {int(frame): _pose(int(frame), pose) for frame, pose in poses.items()}
    views = list(tracks)
    if not all(isinstance(view, Observations) for view in views):
        raise SlamInitError("the tracks are no Observations: give slam_init.Observations, one for each frame")
    views.sort(key=lambda view: view.frame)
    history = History(camera, max(len(views), 1))
    for view in views:
        check_rays(camera, view)
        history.add(view)
    with single_threaded():
        try:
            return _audited(known, history, config)
        except np.linalg.LinAlgError as error:
            raise SlamInitError(f"the tracks have no solution ({error}): give more tracks, or further views") from None


def _pose(frame: int, given: Pose | ArrayLike) -> Pose:
    """The pose of a frame, checked."""
    what = f"the pose of frame {frame}"
    if not isinstance(given, Pose):
        matrix = as_array(given, np.float64, (4, 4), what, "world_from_cam (4, 4)")
        given = Pose(matrix[:3, :3].copy(), matrix[:3, 3].copy())
    if problem := given.problem():
        raise SlamInitError(f"{what} {problem}")
    return given


def _audited(known: Mapping[int, Pose], history: History, config: Config) -> Audit:
    views = _chosen(known, history, config)
    pair = views.pair
    pose, threshold_rad = pose_at_fitting_threshold(history.camera, config, pair)
    frames = (pair.reference.frame, pair.current.frame)
    noise_px, proposed = config.map.noise_px, list[Motion]()
    if isinstance(pose, RelativePose):
        noise_px = max(config.map.min_noise_px, pose.noise_rad * history.camera.focal_px)
        proposed = motions_of_pair(pose, frames, pair.rays1, pair.rays2)
    tracks = gather_tracks(history.camera, views.all, noise_px, config.map.min_noise_px)
    given = _motion_of({frame: known[frame] for frame in tracks.frames if frame in known})
    lens = CurrentLens.of(history.camera)
    # No turning of the camera is known, so that the readout of a rolling shutter moves no pixel.
    priors = replace(priors_of(lens, config), readout_sigma_s=0.0)
    # A wrong map must not set the noise, so that the proposals come first.
    hypotheses = fit_hypotheses(tracks, [*proposed, given], priors)
    if hypotheses is None:
        raise SlamInitError(f"frames {frames[0]} and {frames[1]} share too few tracks: give frames that share more")
    risk = risk_of(hypotheses)
    terms = posterior_of(hypotheses, risk, known)
    if terms.total <= config.acceptance.max_risk:
        risk = with_zooming_rotation(hypotheses, risk)
        terms = posterior_of(hypotheses, risk, known)
    window = EvaluatedWindow(pair, hypotheses, risk, lens, threshold_rad)
    return _stated(known, window, terms, config.acceptance.max_risk)


def _motion_of(world_from_cam: Mapping[int, Pose]) -> Motion:
    """The motion of a map, the pair first: the reference is the world, and the baseline of the pair the unit."""
    reference, current, *_ = world_from_cam.values()
    unit = float(np.linalg.norm(current.t - reference.t))
    relative = {frame: pose.inverse() @ reference for frame, pose in world_from_cam.items()}
    return Motion({frame: Pose(pose.R, pose.t / unit) for frame, pose in relative.items()})


def _chosen(known: Mapping[int, Pose], history: History, config: Config) -> WindowViews:
    """The views of a window: the most informative pair about its direction, and further ones."""
    frames = sorted(frame for frame in known if frame in history)
    if len(frames) < 2:
        raise SlamInitError(f"{len(frames)} of the poses belong to a frame with tracks: give two or more of one camera")
    frames = [frames[k] for k in evenly_spaced(len(frames), _MOST_FRAMES).tolist()]
    centres = np.array([known[frame].t for frame in frames])
    baselines = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    if baselines.max() <= _ONE_PLACE * np.abs(centres).max(initial=0.0):
        raise SlamInitError("all cameras of the map are at one place: it has no baseline to evaluate")
    wide = baselines >= SHORTEST_BASELINE * baselines.max()
    previews: list[PairPreview] = []
    for k, frame in enumerate(frames):
        references = [history[frames[i]] for i in np.flatnonzero(wide[k, :k]).tolist()]
        previews += preview_pairs(history.camera, references, history[frame], config.map.noise_px)
    least = config.keyframes.min_matches
    best = max(previews, key=lambda one: (one.matches >= least, one.direction_score))
    if best.matches < least:
        raise SlamInitError(f"no two frames with a pose share {least} tracks: give frames that share more")
    pair = MatchedPair(best, history[best.reference], history[best.current])
    further = further_views(
        history, pair.reference, pair.current, config.map, MAX_VIEWS - 2, frozenset(known), later_share=_SAME_SCENE
    )
    return WindowViews.of(pair, further)


def _stated(known: Mapping[int, Pose], window: EvaluatedWindow, terms: MapPosterior, max_risk: float) -> Audit:
    """The verdict on the map, and what would decide."""
    risk, best = window.risk, window.best
    rotation_deg, direction_deg = best.differences_deg(known)[best.frames[1]]
    verdict = AuditVerdict.WRONG if terms.total > WRONG else AuditVerdict.DOUBTFUL
    verdict = AuditVerdict.SOUND if terms.total <= max_risk else verdict
    is_best = is_near(known, best)
    reason, advice = _what_decides(window, terms, verdict, max_risk, _AT_A_DISTANCE if is_best else _ANOTHER_MOTION)
    return Audit(
        verdict=verdict,
        risk=min(1.0, terms.total + UNMODELLED_RISK),
        model_risk=terms.total,
        risk_direction=terms.direction,
        risk_competing=terms.competing,
        risk_rotation=terms.rotation,
        risk_moving=terms.moving,
        risk_floor=terms.floor,
        risk_map=terms.map,
        direction_sigma_deg=risk.directions.sigma_deg,
        rotation_sigma_deg=risk.directions.rotation_sigma_deg,
        pair=(best.frames[0], best.frames[1]),
        frames=best.frames,
        tracks=len(window.hypotheses.tracks.track_ids),
        rotation_deg=rotation_deg,
        direction_deg=direction_deg,
        better=None if is_best or terms.only_rotates else best.cam2_from_cam1,
        reason=reason,
        advice=advice,
    )


def _what_decides(
    window: EvaluatedWindow, terms: MapPosterior, verdict: AuditVerdict, max_risk: float, of_map: str
) -> tuple[Verdict | None, str]:
    """The reason of the largest term and what would decide; ``of_map`` where this is the distance of the map."""
    if verdict is AuditVerdict.SOUND:
        return None, ""
    if terms.only_rotates:
        return Verdict.PURE_ROTATION, Verdict.PURE_ROTATION.advice
    competing = Verdict.AMBIGUOUS_PLANE if window.hypotheses.planar else Verdict.LOW_PARALLAX
    # A rigid scene with these tracks may be known well enough.
    if_rigid = Verdict.LOW_PARALLAX if window.risk.directions.if_rigid > max_risk else Verdict.MOVING_OBJECTS
    share, reason = max(
        (terms.rotation, Verdict.PURE_ROTATION),
        (terms.moving, Verdict.MOVING_OBJECTS),
        (terms.competing, competing),
        (terms.direction, if_rigid),
    )
    return (reason, reason.advice) if share > terms.map else (None, of_map)
