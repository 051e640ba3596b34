"""# Your own camera

A calibration is a matrix K, a file, or a number with a deviation. Images come as a folder, a video, or as arrays.
"""

# %%
from dataclasses import replace
from pathlib import Path

import numpy as np

from slam_init import Camera, Initializer, load_camera, open_source

world = open_source("synth:desk?width=240&height=180&slow_start=1")
images = [(frame.image, frame.timestamp_s) for frame in world.frames(0, 24)]  # stands for your camera
K = np.array([[world.camera.fx, 0, world.camera.cx], [0, world.camera.fy, world.camera.cy], [0, 0, 1]])
camera = Camera.from_K(K, (240, 180))
print(camera)

# %% [markdown]
# A calibration in a file: our own YAML, OpenCV, ORB-SLAM, Kalibr, EuRoC, ROS or COLMAP.

# %%
Path("mine.yaml").write_text(f"""\
model: radtan
width: 240
height: 180
fx: {camera.fx}
fy: {camera.fy}
cx: {camera.cx}
cy: {camera.cy}
distortion: [0.0, 0.0, 0.0, 0.0]
""")
print(load_camera("mine.yaml"))


# %% [markdown]
# Images as arrays, with their times in seconds.


# %%
def first_map(camera):
    """Feed the images until there is a map."""
    initializer = Initializer(camera)
    for image, time_s in images:
        if initializer.process(image, time_s):
            break
    return initializer.finish()


result = first_map(load_camera("mine.yaml"))
print(result)
assert result

# %% [markdown]
# A focal length that is off by 3 %, and stated as known to 3 %: a number of a data sheet. The map has an estimate of
# its own, with a deviation. Few frames tell little, so it stays near the stated one. With `Initializer(None)` nothing
# is stated; that needs a camera that turns while it moves, and more frames.

# %%
guess = replace(camera, fx=1.03 * camera.fx, fy=1.03 * camera.fy, focal_sigma=0.03)
result = first_map(guess)
print(result if not result else result.map.camera)
print(f"true focal length {camera.fx:.1f} px")
