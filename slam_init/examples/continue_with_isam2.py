"""Go on from the initial map: every next frame becomes a pose in gtsam's ISAM2, and the landmarks keep improving.

The map comes as a factor graph with its optimum. ISAM2 takes both as they are; for each next frame the tracker says
which landmarks are seen where, resection gives the initial pose, and a projection factor for each landmark goes into
the update. Where the focal length was adjusted with the map it is a variable of the graph, and keeps improving as well.

Run it as ``python -m slam_init.examples.continue_with_isam2 [SOURCE]``.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any

import numpy as np

from slam_init.bundle.graph import calibration_key, landmark_key, measured_pixels, pose_key, projection
from slam_init.datasets import open_source
from slam_init.errors import SlamInitError
from slam_init.evaluation.metrics import align_positions
from slam_init.frontend.tracks import Tracker
from slam_init.initializer import Initializer
from slam_init.mapping.triangulation import resect
from slam_init.types.arrays import Floats
from slam_init.types.frame import Frame
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose, Trajectory

__all__ = ["continue_with_isam2", "main"]

#: A track this far from its landmark's projection is on something else: the gate of the two-view estimation, and half
#: as much again for the drift of a track over the frames since.
_GATE_PX = 3.0
#: Half a second of video: most landmarks are still in view, and this example adds none.
_FRAMES = 15


def continue_with_isam2(map_: InitialMap, tracker: Tracker, frames: Iterable[Frame]) -> list[Keyframe]:
    """Add frames to the map one by one.

    Parameters
    ----------
    map_ : InitialMap
        Its graph and values are copied, not changed.
    tracker : Tracker
        As it is after the frame that the map was accepted at.
    frames : iterable of Frame
        The frames that follow.

    Returns
    -------
    list of Keyframe
        The frames that could be located, world_from_cam by the last update, in the map's frame and scale.

    References
    ----------
    Kaess et al., "iSAM2: Incremental Smoothing and Mapping Using the Bayes Tree", IJRR 2012.
    """
    import gtsam

    camera, calibration = map_.camera, calibration_key()
    adjusted = map_.values.exists(calibration)
    # Huber: a track that slides off its landmark must not drag the pose with it (95 % efficient at 1.345).
    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.345)
    noise = gtsam.noiseModel.Robust.Create(huber, gtsam.noiseModel.Isotropic.Sigma(2, map_.noise_px))
    factor = projection(camera, noise, adjusted=adjusted)
    isam = gtsam.ISAM2(_parameters())
    isam.update(map_.graph, map_.values)
    located: list[Frame] = []
    for frame in frames:
        seen = tracker.track(frame)
        tracker.history.forget(keep=())
        points = gtsam.utilities.extractPoint3(isam.calculateEstimate())  # in order of track id, as the map's
        i, j, bearings = map_.seen_in(seen)
        resected = resect(points[i], bearings, _GATE_PX / camera.focal_px)
        if resected is None:
            continue
        world_from_cam, inliers = resected[0].inverse(), resected[1]
        graph, values, pose = gtsam.NonlinearFactorGraph(), gtsam.Values(), pose_key(frame.index)
        for track, pixel in zip(
            map_.track_ids[i[inliers]], measured_pixels(camera, seen.pixels[j[inliers]]), strict=True
        ):
            graph.add(factor(pixel, pose, landmark_key(int(track))))
        values.insert(pose, gtsam.Pose3(gtsam.Rot3(world_from_cam.R), world_from_cam.t))
        # Left alone, ISAM2 would eliminate all that the frame sees last, landmarks included: eight times slower.
        last = gtsam.KeyGroupMap()
        last.insert2(pose, 1)
        if adjusted:
            last.insert2(calibration, 1)
        isam.update(graph, values, constrainedKeys=last)
        located.append(frame)
    estimate = isam.calculateEstimate()
    poses = [estimate.atPose3(pose_key(frame.index)) for frame in located]
    return [
        Keyframe(frame.index, frame.timestamp_s, frame.name, Pose(pose.rotation().matrix(), pose.translation()))
        for frame, pose in zip(located, poses, strict=True)
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Initialize from a source, go on for half a second, print the way; exit codes as ``slam-init run``."""
    arguments = sys.argv[1:] if argv is None else argv
    try:
        return _main(arguments[0] if arguments else "synth:room")
    except SlamInitError as error:
        print(f"continue_with_isam2: {error}", file=sys.stderr)
        return 2


def _main(name: str) -> int:
    source = open_source(name)
    if source.camera is None:
        raise SlamInitError(f"{name} has no calibration: give a source with a camera.yaml")
    initializer, frames = Initializer(source.camera), source.frames()
    for frame in frames:
        if initializer.process(frame):
            break
    result = initializer.finish()
    if result.map is None:
        print(f"not initialized: {result.reason}")
        return 3
    poses = continue_with_isam2(result.map, initializer.tracker, islice(frames, _FRAMES))
    print(f"initialized after {result.frames_to_init} frames; {len(poses)} of the next {_FRAMES} frames located")
    for keyframe in poses:
        x, y, z = keyframe.world_from_cam.t
        print(f"  frame {keyframe.frame}: {x:8.4f} {y:8.4f} {z:8.4f}")
    if source.groundtruth is not None:
        errors = position_errors([*result.map.keyframes, *poses], source.groundtruth)
        print(f"farthest from the ground truth: {100 * errors.max(initial=0):.2f} % of the path's extent")
    return 0


def position_errors(keyframes: Sequence[Keyframe], truth: Trajectory) -> Floats:
    """Distances (N,) of keyframes from the truth after the best similarity, as a share of the path's extent.

    Keyframes without a true pose are left out.
    """
    pairs = [(k.world_from_cam.t, pose.t) for k in keyframes if (pose := truth.at(k.timestamp_s)) is not None]
    if not pairs:
        return np.zeros(0)
    estimated, true = (np.array(positions) for positions in zip(*pairs, strict=True))
    distances = np.linalg.norm(align_positions(estimated, true).apply(estimated) - true, axis=1)
    return np.asarray(distances / np.linalg.norm(np.ptp(true, axis=0)))


def _parameters() -> Any:
    import gtsam

    parameters = gtsam.ISAM2Params()
    # The unit is the median depth: what moved by a hundredth of it is linearized anew (gtsam's default is a tenth).
    parameters.setRelinearizeThreshold(1e-2)
    parameters.relinearizeSkip = 1
    return parameters


if __name__ == "__main__":
    sys.exit(main())
