"""# A plane, and the map that waits

Two views of a plane are explained by two motions, and only one of them is true. Both fit equally well, so the
residuals do not tell. Here are the tracks of a drawn wall, without images. While the views do not decide,
`result.hypotheses` holds both maps.
"""

# %%
import numpy as np

from slam_init import Initializer
from slam_init.datasets.points import open_points

source = open_points("points:wall?noise_px=0.7&baseline=0.2", seed=0)
initializer = Initializer(source.camera)
for observed in source.observations():
    status = initializer.process_tracks(observed)
    maps = initializer.result.hypotheses
    print(f"view {observed.frame}: {status.reason or 'map'}, maps kept: {len(maps)}")
    if len(maps) == 2 and observed.frame == 1:
        undecided = maps
    if status:
        break
assert status

# %% [markdown]
# The truth is known here. After two views, one of the two maps has the right direction of the baseline, and the other
# one is far off.


# %%
def direction_error_deg(map_):
    """Angle between the estimated and the true baseline of the last keyframe."""
    first, last = (source.groundtruth.at(keyframe.timestamp_s) for keyframe in (map_.keyframes[0], map_.keyframes[-1]))
    true = (first.inverse() @ last).t
    found = map_.keyframes[-1].world_from_cam.t
    return np.degrees(np.arccos(found @ true / np.linalg.norm(found) / np.linalg.norm(true)))


errors = [direction_error_deg(one) for one in undecided]
print("two views:", ", ".join(f"{error:.1f} deg" for error in errors))
assert min(errors) < 15 < max(errors)

# %% [markdown]
# Further views vote, and one map is left.

# %%
result = initializer.finish()
print(f"{len(result.map.keyframes)} views: {direction_error_deg(result.map):.1f} deg, risk {result.map.risk:.4f}")
assert direction_error_deg(result.map) < 15
