"""# Go on with ISAM2

The map is a gtsam factor graph with its optimum, so ISAM2 takes it as it is. Each next frame is located by the
landmarks that it sees, and becomes a pose with one projection factor for each of them.
`docs/examples/continue_with_isam2.py` is the same as a program.
"""

# %%
from itertools import islice

import gtsam
import numpy as np

from slam_init import Initializer, open_source
from slam_init.bundle.graph import landmark_key, pose_key
from slam_init.bundle.reprojection import calibration_key, projection
from slam_init.mapping.resection import resect

source = open_source("synth:room?width=240&height=180&slow_start=1")
initializer, frames = Initializer(source.camera), source.frames()
for frame in frames:
    if initializer.process(frame):
        break
map_ = initializer.finish().map
assert map_ is not None
isam = gtsam.ISAM2()
isam.update(map_.graph, map_.values)
print(map_.graph.size(), "factors,", map_.values.size(), "variables")

# %% [markdown]
# `X(frame)` is the pose `world_from_cam` of a frame, `L(track)` a landmark, and `K(0)` the lens, which has a prior.

# %%
noise = gtsam.noiseModel.Robust.Create(
    gtsam.noiseModel.mEstimator.Huber.Create(1.345), gtsam.noiseModel.Isotropic.Sigma(2, map_.noise_px)
)
located = []
for frame in islice(frames, 3):
    seen = initializer.tracker.track(frame)
    points = gtsam.utilities.extractPoint3(isam.calculateEstimate())  # in the order of track ids, like the map
    i, j, bearings = map_.seen_in(seen)
    pose, inliers = resect(points[i], bearings, 3.0 / map_.camera.focal_px)
    graph, values, key = gtsam.NonlinearFactorGraph(), gtsam.Values(), pose_key(frame.index)
    factor = projection(map_.camera, seen.pixels[j[inliers]], noise, adjusted=map_.values.exists(calibration_key()))
    for n, track in enumerate(map_.track_ids[i[inliers]].tolist()):
        graph.add(factor(n, key, landmark_key(track)))
    world_from_cam = pose.inverse()
    values.insert(key, gtsam.Pose3(gtsam.Rot3(world_from_cam.R), world_from_cam.t))
    isam.update(graph, values)
    located.append((frame, len(inliers)))

# %% [markdown]
# The positions after the last update, and the true ones in the frame of the map. The scale of the map is not known,
# so the ratio of the lengths is taken from the last pose.

# %%
estimate = isam.calculateEstimate()
first = source.groundtruth.at(map_.keyframes[0].timestamp_s)
found = np.array([estimate.atPose3(pose_key(frame.index)).translation() for frame, _ in located])
true = np.array([(first.inverse() @ source.groundtruth.at(frame.timestamp_s)).t for frame, _ in located])
true *= np.linalg.norm(found[-1]) / np.linalg.norm(true[-1])
for (frame, count), position, truth in zip(located, found, true, strict=True):
    print(f"frame {frame.index}: {count} landmarks, {np.round(position, 4)}, true {np.round(truth, 4)}")
assert np.linalg.norm(found - true, axis=1).max() < 0.1 * np.linalg.norm(true[-1])
