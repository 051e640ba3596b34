"""Folders that the tests use."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: Real sequences; tests that need one skip where it is absent.
DATA = Path(os.environ.get("SLAM_INIT_DATA", ROOT.parent / "shared" / "data"))
