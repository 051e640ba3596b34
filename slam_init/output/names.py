"""The names of the files that commands write. The command line reads them, so the module imports no heavy library."""

from __future__ import annotations

__all__ = ["COLMAP_FILES", "COMPARE_FILES", "INTERRUPTED", "OVERVIEW", "RECORDING", "RUN_FILES", "TRIALS", "UNFINISHED"]

#: The text model of COLMAP: cameras, images, points.
COLMAP_FILES = ("colmap/cameras.txt", "colmap/images.txt", "colmap/points3D.txt")
#: The recording of a run. :mod:`slam_init.recording.rerun_recorder` writes it during the run.
RECORDING = "recording.rrd"
#: The recording of a run that was interrupted, beside the results of an earlier run.
INTERRUPTED = "interrupted.rrd"
#: The picture of a run, drawn at its end.
OVERVIEW = "overview.png"
#: End of the name of a recording until it is complete.
UNFINISHED = ".partial.rrd"
#: All files that a run can write.
RUN_FILES = (
    "trajectory.txt",
    "map.ply",
    *COLMAP_FILES,
    "graph.txt",
    "values.txt",
    "continued.txt",
    "config.toml",
    OVERVIEW,
    RECORDING,
    INTERRUPTED,
    "summary.json",
)
#: The trials of a comparison, one a line, written as they finish.
TRIALS = "trials.jsonl"
#: All files that a comparison can write, without its recordings.
COMPARE_FILES = (TRIALS, "results.csv", "report.html", "summary.json")
