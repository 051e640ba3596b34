"""Continue from the initial map with gtsam's ISAM2: each next frame adds a pose, and the landmarks are refined.

The initial map contains a factor graph and its optimum, and ISAM2 takes both without changes. For each next frame the
tracker gives the pixels of the landmarks, resection gives the initial pose, and the update adds one projection factor
for each landmark. The lens is a variable of the graph with a prior, and is refined as well.

Run it as ``python docs/examples/continue_with_isam2.py [SOURCE [CALIBRATION]]``: a video or any other source, and a
file of its calibration where the source has none. Without both the focal length is estimated.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any

import numpy as np

from slam_init.bundle.graph import landmark_key, pose_key
from slam_init.bundle.reprojection import calibration_key, projection
from slam_init.calibration.files import load_camera
from slam_init.datasets import open_source
from slam_init.errors import SlamInitError
from slam_init.evaluation.metrics import align_positions
from slam_init.frontend.tracks import Tracker
from slam_init.initializer import Initializer
from slam_init.mapping.resection import resect
from slam_init.types.arrays import Floats
from slam_init.types.frame import Frame
from slam_init.types.initial_map import InitialMap, Keyframe
from slam_init.types.pose import Pose, Trajectory

#: A track that is farther than this from the projection of its landmark is an outlier. The value is the threshold of
#: the two-view estimation (2 px) plus half of it for the drift of the track since then.
_GATE_PX = 3.0
#: Half a second of video. Most landmarks remain in view for this time; this example adds no landmarks.
_FRAMES = 15


def continue_with_isam2(map_: InitialMap, tracker: Tracker, frames: Iterable[Frame]) -> list[Keyframe]:
    """Add frames to a map one by one.

    Kaess et al., "iSAM2: Incremental Smoothing and Mapping Using the Bayes Tree", IJRR 2012.

    * ``map_``: The map. ISAM2 copies its graph and values; they are not changed.
    * ``tracker``: The tracker in its state after the frame at which the map was accepted. The function moves it on.
    * Returns: The frames that were located: world_from_cam after the last update, in the frame and scale of the map.
    """
    import gtsam

    camera, calibration = map_.camera, calibration_key()
    adjusted = map_.values.exists(calibration)
    noise = _robust_noise(map_)
    isam = gtsam.ISAM2(_parameters())
    isam.update(map_.graph, map_.values)
    located: list[Frame] = []
    for frame in frames:
        seen = tracker.track(frame)
        tracker.history.forget(keep=())
        estimate = isam.calculateEstimate()
        points = np.array([estimate.atPoint3(landmark_key(track)) for track in map_.track_ids.tolist()])
        i, j, bearings = map_.seen_in(seen)
        resected = resect(points[i], bearings, _GATE_PX / camera.focal_px)
        if resected is None:
            continue
        world_from_cam, inliers = resected[0].inverse(), resected[1]
        graph, values, pose = gtsam.NonlinearFactorGraph(), gtsam.Values(), pose_key(frame.index)
        factor = projection(camera, seen.pixels[j[inliers]], noise, adjusted=adjusted)
        for number, track in enumerate(map_.track_ids[i[inliers]].tolist()):
            if (made := factor(number, pose, landmark_key(track))) is not None:
                graph.add(made)
        values.insert(pose, gtsam.Pose3(gtsam.Rot3(world_from_cam.R), world_from_cam.t))
        # Only the pose is eliminated last. By default ISAM2 also eliminates all landmarks of the frame last, which is
        # eight times slower.
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
    """Initialize from a source, continue for half a second, and print the camera positions.

    * ``argv``: The source (``synth:room`` by default), and a file of its calibration; the arguments of the process by
      default.
    """
    arguments = sys.argv[1:] if argv is None else argv
    try:
        return _main(*(arguments or ["synth:room"])[:2])
    except SlamInitError as error:
        print(f"continue_with_isam2: {error}", file=sys.stderr)
        return 2


def _main(name: str, calibration: str | None = None) -> int:
    source = open_source(name)
    camera = source.camera if calibration is None else load_camera(calibration)
    initializer, frames = Initializer(camera), source.frames()
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
        print(f"largest distance from the ground truth: {100 * errors.max(initial=0):.2f} % of the extent of the path")
    return 0


def position_errors(keyframes: Sequence[Keyframe], truth: Trajectory) -> Floats:
    """Compute the position errors of keyframes after alignment by a similarity.

    Shapes: returns (N,).

    * Returns: Distances from the true positions, divided by the diagonal of the box around the true positions.
    """
    pairs = [(k.world_from_cam.t, pose.t) for k in keyframes if (pose := truth.at(k.timestamp_s)) is not None]
    if not pairs:
        return np.zeros(0)
    estimated, true = (np.array(positions) for positions in zip(*pairs, strict=True))
    distances = np.linalg.norm(align_positions(estimated, true).apply(estimated) - true, axis=1)
    return np.asarray(distances / np.linalg.norm(np.ptp(true, axis=0)))


def _robust_noise(map_: InitialMap) -> Any:
    """Return the noise of the pixels of the graph with a Huber kernel, which limits the influence of drifting tracks.

    The graph begins with its reprojection factors. Their noise is larger than that of the residuals, ``map_.noise_px``:
    it covers errors that are not independent, and new factors have them too.
    """
    import gtsam

    # With 1.345 the estimate keeps 95 % of its efficiency for Gaussian noise.
    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.345)
    return gtsam.noiseModel.Robust.Create(huber, map_.graph.at(0).noiseModel())


def _parameters() -> Any:
    import gtsam

    parameters = gtsam.ISAM2Params()
    # Gauss and Newton's steps, the default, send landmarks whose depth is known to a third behind their cameras.
    parameters.setOptimizationParams(gtsam.ISAM2DoglegParams())
    # A variable is linearized again if it moved by more than 0.01 of the median depth, which is the unit of the map.
    # The default of gtsam is 0.1.
    parameters.setRelinearizeThreshold(1e-2)
    parameters.relinearizeSkip = 1
    # A landmark whose depth is known to a third makes equations that Cholesky's factorization, the default, takes for
    # singular.
    parameters.setFactorization("QR")
    return parameters


if __name__ == "__main__":
    sys.exit(main())
