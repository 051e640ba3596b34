"""Comparison of initialization methods on the same tracks, with statistics: ``slam-init compare``.

A *trial* runs one method on one source from one start frame. The tracks of a source are computed once, and all methods
get the same tracks. A trial ends at the first map or at the limit of frames. Each trial has one of these outcomes:

* *correct*: the method accepted a map, and every keyframe is within 5 degrees in rotation and within 15 degrees in the
  direction of its baseline. A correct map is also *strict* if every keyframe is within 1 and 5 degrees. Sequences whose
  ground truth has limits have other bounds (:mod:`slam_init.compare.criteria`).
* *false*: the method accepted any other map. If the camera never translates, every map is false.
* *none*: the method found no map; the row holds the reason.
* *error*: the method raised, did not answer in time, crashed, or used too much memory.

The *wait* of a trial is the number of frames after its start frame until the first correct map: 1 is the second frame.
A trial without a correct map counts as its limit.

===============  ===================================================================================
module           content
===============  ===================================================================================
``run``          a whole comparison, and the command: read first
``sources``      the sequences, how they are opened; ``suites`` has the frozen ones
``replay``       the tracks of a sequence, stored once and replayed for each method
``trials``       the plan of the trials; one trial and its row
``criteria``     how each sequence is evaluated; ``measures`` has the errors of a map
``rows``         the row of a trial, and the rows on disk
``workers``      the processes and the cluster in which trials run
``figures``      the figures of all rows, with ``statistics``
``report``       the tables, and ``report.html``
===============  ===================================================================================
"""
