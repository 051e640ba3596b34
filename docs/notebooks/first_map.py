"""# The first map

A small rendered room: frames go in until there is a map. Every frame gets a status: the stated risk, the reason why
there is no map yet, and an advice. Put a folder or a video in the place of the name of the world.
"""

# %%
import matplotlib.pyplot as plt

from slam_init import Initializer, open_source

source = open_source("synth:room?width=240&height=180&slow_start=1")
initializer = Initializer(source.camera)
for frame in source.frames():
    status = initializer.process(frame)
    risk = "-" if status.risk is None else f"{status.risk:.3f}"
    print(f"frame {frame.index:2d}  risk {risk:>5}  {status.reason or 'map'}")
    if status:
        break

# %% [markdown]
# The result is truthy where there is a map. The map has keyframes, landmarks, a gtsam graph and covariances. Its unit
# is the median depth of the landmarks in the first view.

# %%
result = initializer.finish()
assert result
map_ = result.map
print(result)
print("points", map_.points.shape, " poses", map_.poses.shape, " factors", map_.graph.size())

# %% [markdown]
# From above: the landmarks in their colours, and the path of the camera.

# %%
figure, axes = plt.subplots(figsize=(5, 4))
axes.scatter(map_.points[:, 0], map_.points[:, 2], s=4, c=map_.colors / 255)
axes.plot(map_.poses[:, 0, 3], map_.poses[:, 2, 3], "k.-")
axes.set(xlabel="x (right)", ylabel="z (forward)", aspect="equal")

# %% [markdown]
# `result.save("start")` writes it; `slam_init.export` writes it for COLMAP, nerfstudio and others.
