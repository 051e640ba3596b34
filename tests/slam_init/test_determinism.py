"""The same seed gives the same map to the last bit, in another process and with another number of threads."""

import os
import subprocess
import sys

import pytest
from paths import ROOT

pytestmark = pytest.mark.process

#: A plane with two conjugate motions, which may stay undecided, a general scene with many outliers, and images.
SOURCES = (
    "points:wall?seed=2&noise_px=1.0&views=5&points=150",
    "points:room?seed=3&outliers=0.3&points=200",
    "synth:room?width=320&height=240&seed=1&slow_start=1",
)

DIGEST = """
import hashlib, sys
from slam_init import Config, Initializer
from slam_init.compare.sources import open_compared
for text in sys.argv[1:]:
    source = open_compared(text)
    initializer = Initializer(source.camera)
    points = text.startswith("points:")
    for frame in source.observations() if points else source.frames():
        if initializer.process_tracks(frame) if points else initializer.process(frame):
            break
    found = initializer.finish().map or initializer.provisional.map  # of a plane that stays undecided
    digest = hashlib.sha256(found.points.tobytes() + found.pose_covariances.tobytes())
    for keyframe in found.keyframes:
        digest.update(keyframe.world_from_cam.R.tobytes() + keyframe.world_from_cam.t.tobytes())
    print(len(found.points), digest.hexdigest())
"""


def maps(threads):
    """The number of landmarks and the hash of each map, from a new process."""
    variables = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    done = subprocess.run(
        [sys.executable, "-c", DIGEST, *SOURCES],
        env=os.environ | dict.fromkeys(variables, str(threads)),
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    return done.stdout.split("\n")[: len(SOURCES)]


def test_the_same_seed_gives_the_same_map_on_any_number_of_threads():
    found = maps(threads=1)
    assert all(int(line.split()[0]) >= 50 for line in found)
    assert maps(threads=2) == found
