"""A small exact map with everything that belongs to a run: cameras on an arc, points ahead, pixels, attempts."""

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.bundle.graph import GraphRecipe
from slam_init.bundle.problem import BundleProblem
from slam_init.types.camera import Camera
from slam_init.types.evidence import PreviewEvidence, WindowEvidence
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap, Keyframe, ScaleUncertainty
from slam_init.types.pose import Pose, Trajectory
from slam_init.types.refusal import GateName, Stage, Verdict, at_least, at_most
from slam_init.types.result import Attempt, Result

CAMERAS = {
    "pinhole": Camera("pinhole", 640, 480, 500.0, 510.0, 321.5, 238.25),
    "radtan": Camera("radtan", 640, 480, 500.0, 510.0, 321.5, 238.25, (-0.2, 0.05, 1e-3, -5e-4)),
    "radtan5": Camera("radtan", 640, 480, 500.0, 510.0, 321.5, 238.25, (-0.2, 0.05, 1e-3, -5e-4, 0.01)),
    "fisheye": Camera("fisheye", 640, 480, 300.0, 305.0, 321.5, 238.25, (0.02, -0.01, 3e-3, -1e-3)),
}


def make_poses(count: int) -> tuple[Pose, ...]:
    """world_from_cam on a gentle arc, the first at the origin."""
    return tuple(
        Pose(rotation_from_vector(np.array([0.01, -0.03, 0.005]) * i), np.array([0.1 * i, 0.01 * i * i, 0.03 * i]))
        for i in range(count)
    )


def make_map(model: str = "pinhole", keyframes: int = 4, points: int = 60, noise_px: float = 0.3) -> InitialMap:
    """A map at its true poses and points, with noise on the pixels. Only two keyframes observe landmark 0."""
    rng = np.random.default_rng(7)
    camera, poses = CAMERAS[model], make_poses(keyframes)
    xyz = rng.uniform([-0.35, -0.25, 0.8], [0.45, 0.25, 1.6], (points, 3))
    frames = [10 + 7 * i for i in range(keyframes)]
    views = tuple(
        Keyframe(frame, 1305031102.175304 + frame / 30, f"rgb/{frame:04d}.png", pose)
        for frame, pose in zip(frames, poses, strict=True)
    )
    seen = [(k, i) for k in range(keyframes) for i in range(points) if i > 0 or k < 2]
    k, i = np.array(seen).T
    pixels = np.array([camera.project(poses[a].inverse().apply(xyz[b]))[0] for a, b in seen])
    noisy = pixels + rng.normal(0, noise_px, pixels.shape)
    problem = BundleProblem(tuple(frames), poses, xyz, 3 * np.arange(points), k, i, noisy)
    return InitialMap(
        keyframes=views,
        points=xyz,
        track_ids=3 * np.arange(points),
        observation_keyframes=k,
        observation_landmarks=i,
        observation_pixels=noisy,
        colors=rng.integers(0, 256, (points, 3), dtype=np.uint8),
        pose_covariances=np.zeros((keyframes, 6, 6)),
        point_covariances=np.tile(np.diag([1e-4, 1e-4, 4e-4]), (points, 1, 1)),
        depth_sigmas=np.linspace(0.01, 0.03, points),
        scale_uncertainty=ScaleUncertainty(0.01),
        open_tracks=Observations(
            frames[-1],
            views[-1].timestamp_s,
            views[-1].name,
            3 * np.arange(4) + 1,
            np.array([[10.0, 20.0], [300.0, 20.0], [10.0, 400.0], [300.0, 400.0]]),
            camera.bearings(np.array([[10.0, 20.0], [300.0, 20.0], [10.0, 400.0], [300.0, 400.0]])),
        ),
        gauge="first pose and the distance to the second",
        recipe=GraphRecipe(camera, problem, 1.0),
        points_before=xyz + rng.normal(0, 0.01, xyz.shape),
        keyframes_before=poses,
        bundle_errors=(900.0, 120.0, 60.5, 60.1),
        reprojection_rmse_px=float(np.sqrt(np.mean(np.sum((noisy - pixels) ** 2, axis=1)))),
        median_parallax_deg=12.5,
        noise_px=noise_px,
        scene="general",
        camera=camera,
    )


def make_observations(map_: InitialMap, model: str = "pinhole") -> list[Observations]:
    """The observations of each keyframe, as a tracker returns them."""
    observations = []
    for position, keyframe in enumerate(map_.keyframes):
        mine = map_.observation_keyframes == position
        pixels = map_.observation_pixels[mine]
        ids = map_.track_ids[map_.observation_landmarks[mine]]
        bearings = CAMERAS[model].bearings(pixels)
        observations.append(Observations(keyframe.frame, keyframe.timestamp_s, keyframe.name, ids, pixels, bearings))
    return observations


def make_frame(index: int, timestamp_s: float, name: str, color: bool = True) -> Frame:
    """A textured image of 640x480."""
    rng = np.random.default_rng(index)
    blocks = rng.integers(0, 256, (15, 20, 3) if color else (15, 20), dtype=np.uint8)
    return Frame(index, timestamp_s, name, np.ascontiguousarray(blocks.repeat(32, axis=0).repeat(32, axis=1)))


def make_attempts(map_: InitialMap) -> tuple[Attempt, ...]:
    """Two refusals and an acceptance, with matches, evidence and gates."""
    first, *others = make_observations(map_)
    attempts = []
    for n, other in enumerate(others):
        ids, a, b = np.intersect1d(first.track_ids, other.track_ids, return_indices=True)
        accepted = n == len(others) - 1
        risk = 0.004 if accepted else 0.07
        attempts.append(
            Attempt(
                frames=(first.frame, other.frame),
                verdict=Verdict.ACCEPTED if accepted else Verdict.LOW_PARALLAX,
                advice="" if accepted else Verdict.LOW_PARALLAX.advice,
                gates=(
                    at_least(GateName.MATCHES, 60, 30, Verdict.TOO_FEW_MATCHES),
                    at_most(GateName.RISK, risk, 0.005, Verdict.LOW_PARALLAX),
                ),
                stage=None if accepted else Stage.MAP,
                progress=1.0 if accepted else 0.9,
                pixels1=first.pixels[a],
                pixels2=other.pixels[b],
                inliers=np.arange(len(ids)) % 5 > 0,
                moving=np.arange(len(ids)) % 10 == 5,
                preview=make_preview(parallax_px=2.5 + n),
                window=make_window_evidence(risk),
            )
        )
    return tuple(attempts)


def make_preview(parallax_px: float = 2.5) -> PreviewEvidence:
    """The preview of a pair with a little parallax."""
    return PreviewEvidence(
        matches=60, motion_px=9.0, rotation_deg=0.5, parallax_px=parallax_px, parallax_share=0.6, spread=0.5
    )


def make_window_evidence(risk: float) -> WindowEvidence:
    """The joint estimate of three views, whose risk is that of its direction."""
    return WindowEvidence(
        views=3,
        hypotheses=1,
        planar=False,
        risk=risk,
        risk_direction=risk,
        risk_competing=0.0,
        risk_rotation=0.0,
        risk_moving=0.0,
        risk_floor=0.0,
        direction_sigma_deg=4.0,
        rotation_sigma_deg=0.1,
        depth_sigma=0.05,
        noise_px=0.5,
        correlated_px=0.1,
        rotation_log_likelihood=200.0,
        focal_factor=1.0,
        focal_sigma=0.02,
    )


def make_result(map_: InitialMap | None, reason: Verdict | None = None) -> Result:
    """A run that ended with the map, or without one."""
    return Result(
        map=map_,
        reason=None if map_ is not None else reason,
        advice="" if reason is None else reason.advice,
        frames_read=32,
        frames_to_init=22 if map_ is not None else None,
        attempts=make_attempts(map_ if map_ is not None else make_map()),
        timing_ms={
            "track": {
                "median": 4.0,
                "p95": 6.0,
                "p99": 7.0,
                "largest": 8.0,
                "total": 130.0,
                "calls": 32.0,
            }
        },
        notes=(),
    )


def make_truth(map_: InitialMap, scale: float = 2.5) -> Trajectory:
    """The true trajectory of a map's keyframes in another frame and scale, sampled between them too."""
    R, t = rotation_from_vector(np.array([0.4, -0.2, 1.1])), np.array([3.0, -1.0, 0.5])
    poses = [Pose(R @ k.world_from_cam.R, scale * R @ k.world_from_cam.t + t) for k in map_.keyframes]
    return Trajectory(np.array([k.timestamp_s for k in map_.keyframes]), tuple(poses))


def bytes_of(map_):
    """The frames of a map, and its poses, points and covariances as bytes."""
    poses = [np.concatenate([k.world_from_cam.R.ravel(), k.world_from_cam.t]).tobytes() for k in map_.keyframes]
    return [k.frame for k in map_.keyframes], poses, map_.points.tobytes(), map_.pose_covariances.tobytes()
