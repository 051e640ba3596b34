"""Every way to initialize, on the same tracks, with statistics: ``slam-init compare``.

A *trial* is a method on a source from a start. Tracks are found once for each source and fed to all methods; a trial
ends at the first map or at the limit. An accepted map is *correct* where every keyframe is within 5 degrees in rotation
and 15 in the direction of its baseline, *strict* within 1 and 5, else *false*; where the camera never translates every
map is false. No map is *none*, with its reason; *error* is a method that raised, hung, crashed or ate memory.

==============  ==================================================================================
module          concept
==============  ==================================================================================
``sources``     what is compared on, how far its truth goes, where trials start
``replay``      tracks on disk
``trials``      one trial: a row
``measures``    how good a map is
``isolation``   a process for trials, with limits of time and memory; ``child`` is that process
``backends``    loky, sequential, Dask
``journal``     finished trials on disk
``aggregate``   rows to figures; ``statistics`` has the formulas
``results``     the files; ``report`` is the page
==============  ==================================================================================
"""

from slam_init.compare.plan import Plan
from slam_init.compare.run import compare
from slam_init.compare.sources import ComparedSource, describe_sources
from slam_init.compare.trials import COLUMNS, Settings, Trial, run_trial

__all__ = ["COLUMNS", "ComparedSource", "Plan", "Settings", "Trial", "compare", "describe_sources", "run_trial"]
