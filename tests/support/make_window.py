"""Windows of simulated worlds: tracks with their truth, exact or noisy, and the hypotheses of their pair."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quest import NoPose, RelativePose, algebra, estimate_relative_pose
from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from sequences_synth.points import PointOptions, PointSequence, make_points
from slam_init.config import Config
from slam_init.datasets.synth import PointSource
from slam_init.initializer import Initializer
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.history import common_tracks
from slam_init.types.lens import SAME_LENS, Lens
from slam_init.types.pose import Pose
from slam_init.window.arguments import FIELD_TERMS, ZOOM_TERMS, Limits
from slam_init.window.equations import WindowEquations
from slam_init.window.hypotheses import WindowHypotheses, fit_hypotheses, motions_of_pair
from slam_init.window.joint_fit import JointFit, fit_window, start_noise_factor
from slam_init.window.motion import Motion, OtherMotion
from slam_init.window.risk import WindowRisk
from slam_init.window.state import Priors, WindowState, start_at
from slam_init.window.tracks import WindowTracks, gather_tracks

#: The options of the tests of the window.
WINDOW_CONFIG = Config()
#: A focal length that is nearly known, and no fields of correlated errors.
PRIORS = Priors(focal_sigma=0.02)


@dataclass(frozen=True, eq=False)
class Window:
    """Tracks of a window, and the truth in the frame of its first view."""

    tracks: WindowTracks
    R: np.ndarray
    t: np.ndarray
    points: np.ndarray

    @property
    def plane(self) -> np.ndarray:
        """The plane ``k . X = 1`` of the points."""
        return np.linalg.lstsq(self.points, np.ones(len(self.points)), rcond=None)[0]

    def true_state(self, plane: np.ndarray | None = None) -> WindowState:
        """The truth as a state."""
        anchor = np.maximum(self.tracks.anchor, 0)
        in_anchor = np.einsum("tij,tj->ti", self.R[anchor], self.points) + self.t[anchor]
        distance = np.linalg.norm(in_anchor, axis=1)
        field = np.zeros((len(self.R), 12))
        on_plane = np.full(len(distance), plane is not None)
        rays = in_anchor / distance[:, None]
        return WindowState(self.R.copy(), self.t.copy(), rays, 1 / distance, SAME_LENS, field, plane, on_plane)

    def start(self, seed: int, plane: np.ndarray | None = None, error: float = 0.02) -> WindowState:
        """A state near the truth: rotations off by half of the error (rad), baselines by a share of their length."""
        rng = np.random.default_rng((seed, 17))
        R, t = self.R.copy(), self.t.copy()
        for k in range(1, len(R)):
            R[k] = rotation_from_vector(0.5 * error * rng.uniform(-1, 1, 3)) @ R[k]
            t[k] += error * np.linalg.norm(t[k]) * rng.uniform(-1, 1, 3)
        return start_at(self.tracks, R, t, plane)

    def rotation_error(self, state: WindowState) -> float:
        """Largest difference of an element of a rotation."""
        return float(np.abs(state.R - self.R).max())

    def direction_error(self, state: WindowState) -> float:
        """Largest chord between the found and the true direction of a centre from the first view."""
        found, true = (np.einsum("kji,kj->ki", s.R, s.t)[1:] for s in (state, self))
        unit = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (found, true))
        return float(np.linalg.norm(np.subtract(*unit), axis=1).max())


def make_window(
    scene: str = "room",
    seed: int = 0,
    views: int = 3,
    points: int = 60,
    *,
    noise_px: float = 0.0,
    sigma_px: float = 0.7,
    baseline: float = 0.2,
    camera: Camera | None = None,
    stated: Camera | None = None,
    turning: float = 0.0,
) -> Window:
    """A window without outliers of a simulated world, seen by a camera of any model.

    The views turn about the vertical and the optical axis by up to ``turning`` radians. The camera that the tracks
    state may differ from the one that sees the points.
    """
    options = PointOptions(views=views, points=points, noise_px=0, outliers=0, baseline=baseline)
    sequence = make_points(scene, seed, options)
    camera = camera or camera_of(sequence)
    cam_from_world = np.linalg.inv(sequence.poses)
    first = cam_from_world[0]
    X = sequence.points @ first[:3, :3].T + first[:3, 3]
    relative = cam_from_world @ sequence.poses[0]
    R, t = relative[:, :3, :3].copy(), relative[:, :3, 3].copy()
    for k in range(1, views):
        turn = rotation_from_vector(turning * np.array([0.3, np.sin(2.0 * k), np.cos(1.7 * k)]))
        R[k], t[k] = turn @ R[k], turn @ t[k]
    rng = np.random.default_rng((seed, 23))
    pixels = np.array([camera.project(X @ R[k].T + t[k]) for k in range(views)])
    with np.errstate(invalid="ignore"):
        seen = ((pixels >= 0) & (pixels <= (camera.width - 1, camera.height - 1))).all(axis=-1)
    pixels = pixels + noise_px * rng.normal(size=pixels.shape)
    tracks = WindowTracks.gather(
        stated or camera, tuple(range(views)), np.arange(len(X)), pixels, seen, noise_px or sigma_px
    )
    return Window(tracks, R, t, X)


def camera_of(sequence: PointSequence) -> Camera:
    """The true camera of a sequence."""
    c = sequence.shot.camera
    return Camera("pinhole", c.width, c.height, c.fx, c.fy, c.cx, c.cy)


def point_source(scene: str, seed: int = 0, **options: float) -> PointSource:
    """A simulated world with noise and outliers, as a source of tracks."""
    return PointSource.of(make_points(scene, seed, PointOptions(**options)))


def pair_and_further(observations: Sequence[Observations], views: int) -> list[Observations]:
    """The first ``views`` frames in the order of a window: the first and the last one, then those between."""
    return [observations[0], observations[views - 1], *observations[1 : views - 1]]


def pose_of_pair(
    camera: Camera, reference: Observations, current: Observations
) -> tuple[RelativePose | NoPose, np.ndarray, np.ndarray]:
    """The pose of a pair with its matched rays; the pose is falsy where there is none."""
    i, j = common_tracks(reference, current)
    rays1, rays2 = reference.bearings[i], current.bearings[j]
    return estimate_relative_pose(rays1, rays2, threshold_rad=2.0 / camera.focal_px), rays1, rays2


def motions_of(camera: Camera, views: Sequence[Observations], **changed) -> list[Motion]:
    """The motions that the pair of a window proposes, after changes of its pose."""
    pose, rays1, rays2 = pose_of_pair(camera, *views[:2])
    assert isinstance(pose, RelativePose)
    return motions_of_pair(replace(pose, **changed), (views[0].frame, views[1].frame), rays1, rays2)


def hypotheses_of(
    camera: Camera, views: Sequence[Observations], priors: Priors, noise_px: float = 0.7, **changed
) -> WindowHypotheses | None:
    """The fitted hypotheses of a window, reference and current first; None where the pair proposes no translation."""
    if not pose_of_pair(camera, *views[:2])[0]:
        return None
    return fit_hypotheses(gather_tracks(camera, views, noise_px), motions_of(camera, views, **changed), priors)


def true_motion(source: PointSource, reference: int, current: int) -> Pose:
    """The true cam2_from_cam1 of two frames."""
    poses = source.groundtruth.world_from_cam
    return poses[current].inverse() @ poses[reference]


def pose_errors_deg(found: Pose, true: Pose) -> tuple[float, float]:
    """Errors of the rotation and of the direction of the baseline."""
    cosine = found.centre @ true.centre / np.linalg.norm(found.centre) / np.linalg.norm(true.centre)
    return float(np.degrees(rotation_angle(found.R.T @ true.R))), float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def pose_covariance(fit, view):
    """Covariance (6, 6) of cam_from_world of a view (rotation vector from the left, translation), by Laplace."""
    columns = 6 * (view - 1) + np.arange(6)
    return np.linalg.inv(fit.information)[np.ix_(columns, columns)]


def direction_covariance(fit: JointFit, view: int) -> tuple[np.ndarray, np.ndarray]:
    """Covariance (2, 2) of the direction R^T t of a view's baseline in radians, and its basis (2, 3)."""
    R, t = fit.state.R[view], fit.state.t[view]
    basis = np.linalg.svd((R.T @ t)[None])[2][1:]
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    J = basis @ np.hstack([R.T @ cross, R.T]) / np.linalg.norm(t)
    return J @ pose_covariance(fit, view) @ J.T, basis


def direction_sigma_deg(fit: JointFit, view: int = 1) -> float:
    """Largest standard deviation of the direction of a view's baseline."""
    return float(np.degrees(np.sqrt(np.linalg.eigvalsh(direction_covariance(fit, view)[0])[-1])))


def focal_sigma(fit: JointFit) -> float:
    """Posterior standard deviation of the logarithm of the focal scale, of a fit without correlated errors."""
    column = 6 * (len(fit.state.R) - 1)
    return float(np.sqrt(np.linalg.inv(fit.information)[column, column]))


def equations(tracks: WindowTracks, state: WindowState, gate: float, **unknowns: bool) -> WindowEquations:
    """The equations at a state, by the compiled loop, without any prior; ``unknowns`` are those of a layout."""
    field = unknowns.get("field", 0)
    priors = replace(
        PRIORS, gate_sigmas=gate, readout_sigma_s=float(unknowns.get("readout", False)),
        principal_sigma_px=float(unknowns.get("principal", False)), field_sigma_px=float(field == FIELD_TERMS),
        zoom_sigma=float(field == ZOOM_TERMS), shift_sigma_px=1.0,
    )  # fmt: skip
    made = WindowEquations(tracks, state, priors)
    made._problem.known.weights[:] = 0.0
    for array in (*made._equations[:2], *made._equations[5:], *made._room[:5]):
        array[:] = np.nan  # all that is read must have been written
    made.build(state, hold=False)
    return made


def moved(
    state: WindowState,
    step: np.ndarray,
    found: WindowEquations,
    *,
    field: int = 0,
    readout: bool = False,
    principal: bool = False,
) -> WindowState:
    """The state after a step of the shared unknowns, with the tracks following to first order.

    The unknowns have the order of :mod:`slam_init.window.kernel`. A track moves by ``-A^-1 W step``. The gradient
    of the track is left out, so that the tracks do not move without a step.
    """
    R, t, coefficients = state.R.copy(), state.t.copy(), state.field.copy()
    rest = list(step)

    def next_unknowns(count: int) -> np.ndarray:
        unknowns = np.array(rest[:count])
        del rest[:count]
        return unknowns

    for k in range(len(R)):
        if k:
            R[k] = rotation_from_vector(next_unknowns(3)) @ R[k]
            t[k] = t[k] + next_unknowns(3)
        coefficients[k, :field] += next_unknowns(field)
    log_scale, k1 = state.lens.log_scale + float(next_unknowns(1)[0]), state.lens.k1 + float(next_unknowns(1)[0])
    readout_s = state.lens.readout_s + (float(next_unknowns(1)[0]) if readout else 0.0)
    x, y = state.lens.principal_px + (next_unknowns(2) if principal else np.zeros(2))
    lens = Lens(log_scale, k1, readout_s, (float(x), float(y)))
    plane = None if state.plane is None else state.plane + next_unknowns(3)
    pulls = [found.coupling_along(np.tile(axis, (len(state.rays), 1))) @ step for axis in np.eye(3)]
    local = -np.einsum("tpq,qt->tp", found.track_covariances, pulls)
    tangents = np.array([np.reshape(algebra.tangents(ray), (2, 3)) for ray in state.rays])
    rays = state.rays + np.einsum("tq,tqj->tj", local[:, :2], tangents)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    inverse = state.inverse_distances + local[:, 2]
    return WindowState(R, t, rays, inverse, lens, coefficients, plane, state.on_plane)


def fit_near_truth(window, priors=PRIORS, kind="general", seed=0, tolerance=1e-10):
    """The fit from a start near the truth, first with the noise of the start, then with that of the tracks."""
    start = window.start(seed, 1.03 * window.plane if kind == "plane" else None)
    tracks = window.tracks
    coarse = tracks.with_noise(tracks.noise_px * start_noise_factor(tracks, start, priors))
    start = fit_window(coarse, start, priors, limits=Limits(tolerance=tolerance)).state
    return fit_window(tracks, start, priors, limits=Limits(50, tolerance))


def fitted_window(scene: str, seed: int, views: int) -> JointFit:
    """The fit of a noisy window of a simulated world from the true poses."""
    window = make_window(scene, seed, views, noise_px=0.7, baseline=0.3)
    return fit_window(window.tracks, start_at(window.tracks, window.R, window.t), PRIORS)


#: Views of :func:`hypotheses_of_changing_lens`.
VIEWS_OF_CHANGING_LENS = 8


def hypotheses_of_changing_lens(
    scene, seed=0, zoom=0.0, shift=0.0, ramp=0.0, points=150, image_k1=0.0, jumping=0.0, **options
):
    """A window whose views but the first are zoomed about the centre of the image, and shifted over its width.

    * ``ramp``: A steady zoom, from the first view to the last one in time.
    * ``image_k1``: A distortion of the image, which no zoom moves.
    * ``jumping``: Share of the tracks that jump to another point half-way.
    """
    source = point_source(scene, seed, points=points, **options)
    camera, random = source.camera, np.random.default_rng(seed)
    centre, views = np.array([camera.width, camera.height]) / 2, []
    chosen = pair_and_further(list(source.observations()), VIEWS_OF_CHANGING_LENS)
    last = max(view.frame for view in chosen) - chosen[0].frame
    for k, view in enumerate(chosen):
        factor, moved = 1 + zoom * random.normal() * (k > 0), shift * camera.width * random.normal(size=2) * (k > 0)
        factor *= 1 + ramp * (view.frame - chosen[0].frame) / last
        zoomed = factor * (view.pixels - centre)
        bent = 1 + image_k1 * np.sum((zoomed / camera.focal_px) ** 2, axis=1, keepdims=True)
        pixels = centre + bent * zoomed + moved
        if jumping and 2 * (view.frame - chosen[0].frame) > last:
            pixels += np.where(view.track_ids % round(1 / jumping) == 0, 15.0, 0.0)[:, None]
        views.append(replace(view, pixels=pixels, bearings=camera.bearings(pixels)))
    return hypotheses_of(camera, views, Priors(0.02, principal_sigma_px=2.0))


def window_of(scene, seed, views, last=None, **options):
    """A simulated source, and its first and last frame with evenly spaced frames between."""
    source = point_source(scene, seed, **options)
    observations = list(source.observations())
    picks = np.linspace(0, len(observations) - 1 if last is None else last, views).round().astype(int)
    return source, pair_and_further([observations[k] for k in picks], views)


def hypotheses_of_scene(scene, seed, views, last=None, priors=None, **options):
    """The hypotheses of such a window."""
    source, part = window_of(scene, seed, views, last, **options)
    return hypotheses_of(source.camera, part, priors or Priors(focal_sigma=0.03))


def fed(initializer, observations):
    """The initializer after the tracks of some frames, up to its map."""
    for observed in observations:
        if initializer.process_tracks(observed):
            break
    return initializer


def finished(source, config=WINDOW_CONFIG):
    """The result after the tracks of a source, up to the map."""
    return fed(Initializer(source.camera, config), source.observations()).finish()


def errors_deg(source, map_):
    """Errors of the motion of the first two keyframes of a map."""
    first, second = map_.keyframes[:2]
    found = second.world_from_cam.inverse() @ first.world_from_cam
    return pose_errors_deg(found, true_motion(source, first.frame, second.frame))


def is_right(source, map_):
    """Whether the motion of the first two keyframes of a map is that of the source."""
    rotation, direction = errors_deg(source, map_)
    return rotation < 5 and direction < 15


def motion_errors_deg(source, motion):
    """Errors of a fitted motion of a pair."""
    return pose_errors_deg(motion.cam2_from_cam1, true_motion(source, *motion.frames[:2]))


def is_motion_of(source, motion, rotation_deg, direction_deg):
    """Whether both errors of a fitted motion of a pair are below these bounds."""
    rotation, direction = motion_errors_deg(source, motion)
    return rotation < rotation_deg and direction < direction_deg


def looks_small(risk: WindowRisk) -> WindowRisk:
    """A risk whose terms are all 0, beside which the camera that rotates and zooms is looked for."""
    return replace(risk, direction=0.0, competing=0.0, rotation=0.0, other=OtherMotion())
