"""The bound on the maps of a run that starts anew after a loss; without libraries, as the command line reads it."""

from __future__ import annotations

#: Largest number of maps of a run: a map takes some megabytes of memory.
MAX_SEGMENTS = 99
