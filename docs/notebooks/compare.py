"""# Compare methods

Every method gets the same tracks. *Correct*: all keyframes are within 5 degrees in rotation and 15 in the direction
of the baseline. *False*: any other map. Worlds of points take no rendering; give folders with images and truth in
their place.
"""

# %%
import csv
from collections import Counter
from pathlib import Path

from slam_init.cli.main import main

worlds = [
    "points:room?noise_px=0.7&baseline=0.1",
    "points:wall?noise_px=0.7&baseline=0.1",
    "points:rotation?noise_px=0.7",
]
assert main(["compare", *worlds, "--methods", "quest,essential-5pt,orb-slam3", "--jobs", "1", "--out", "compared"]) == 0

# %% [markdown]
# `compared/report.html` has the tables with charts. `results.csv` has one line a trial.

# %%
with Path("compared/results.csv").open() as file:
    trials = list(csv.DictReader(file))
for trial in trials:
    print(f"{trial['source'].partition('?')[0]:16} {trial['method']:14} {trial['outcome']}")
outcomes = Counter((trial["method"], trial["outcome"]) for trial in trials)
assert outcomes["quest", "false"] == 0

# %% [markdown]
# Three trials tell nothing about a method. `slam-init compare --suite drawn` has 1,000 such worlds.
