"""Comparison of initialization methods on the same tracks, with statistics: ``slam-init compare``.

A *trial* runs one method on one source from one start frame. The tracks of a source are computed once, and all methods
get the same tracks. A trial ends at the first map or at the limit of frames. Each trial has one of these outcomes:

* *correct*: the method accepted a map, and every keyframe is within 5 degrees in rotation and within 15 degrees in the
  direction of its baseline. A correct map is also *strict* if every keyframe is within 1 and 5 degrees. Sequences whose
  ground truth has limits have other bounds (:mod:`slam_init.compare.judging`).
* *false*: the method accepted any other map. If the camera never translates, every map is false.
* *none*: the method found no map; the row holds the reason.
* *error*: the method raised, did not answer in time, crashed, or used too much memory.

The *wait* of a trial is the number of frames after its start frame until the first correct map: 1 is the second frame.
A trial without a correct map counts as its limit.

===================  ===============================================================================
module               content
===================  ===============================================================================
``sources``          the sequences, the start frames
``judging``          how each sequence is judged: the bounds of a correct map
``plan``             the list of trials
``replay``           tracks on disk
``trials``           one trial, and how its row is made
``rows``             the row of a trial, and its line in the files
``measures``         the quality of a map
``isolation``        starts a process for trials, with limits of time and memory
``messages``         the requests to this process, and its answers
``worker``           the program that runs in this process; ``answers`` is its other part, and its guard is
                     :mod:`slam_init.system.process_guard`
``backends``         loky, sequential, Dask
``journal``          finished trials on disk
``statistics``       intervals and tests
``wait``             the wait, and its differences between methods
``reliability``      the stated risk compared with the share of false maps
``trial_table``      all rows as a table of columns
``aggregate``        figures from this table
``summary``          all figures of a comparison, as in ``summary.json``
``extras``           the additions of a benchmark; ``trajectories`` in the formats of other tools
``results``          the output files; ``recordings`` has the names of the recordings
``report``           the HTML page; ``report_tables``, ``report_gallery``, ``html_table``, ``charts``,
                     ``failure_gallery`` and ``method_colors`` are its parts
``trial_recording``  the recording of a trial
``side_by_side``     the recording of all methods; ``map_snapshot`` and ``methods_recorder`` are its parts
===================  ===============================================================================
"""

from slam_init.compare.plan import Plan
from slam_init.compare.rows import COLUMNS, TrialRow
from slam_init.compare.run import compare
from slam_init.compare.sources import ComparedSource, describe_sources
from slam_init.compare.summary import ComparisonSummary
from slam_init.compare.trials import Settings, Trial, run_trial

__all__ = [
    "COLUMNS",
    "ComparedSource",
    "ComparisonSummary",
    "Plan",
    "Settings",
    "Trial",
    "TrialRow",
    "compare",
    "describe_sources",
    "run_trial",
]
