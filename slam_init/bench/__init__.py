"""InitBench: a public benchmark of vision-only initialization with a fixed, named protocol: ``slam-init bench``.

The trials, the judging and the files are those of :mod:`slam_init.compare`. InitBench adds a protocol with a name and
a version, so that a figure can be cited: fixed worlds and sequences, digests of the tracks that all methods get, one
score sheet, and a page that ranks the sheets of several runs.

===================  ===============================================================================
module               content
===================  ===============================================================================
``protocol``         name and version; what a run is; the worlds of the suites ``drawn`` and ``rendered``; digests of
                     the tracks of this version
``manifest``         the suite ``video``: public sequences, where to get each, their checksums
``generator``        the suite ``other``: archives of tracks, drawn by a generator that is given by its folder
``convert``          converters of the published layouts that no reader takes
``sheet``            the score sheet with its strata; ``sheet_text`` writes it as Markdown
``command``          runs ``slam-init bench``
``leaderboard``      runs ``slam-init bench publish``
===================  ===============================================================================
"""
