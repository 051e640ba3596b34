"""Summaries and files for tests of the command line."""

from make_map import make_map, make_result
from make_summary import summarize

from slam_init.types.refusal import Verdict

IMAGES = "my images é"
WITH = ["--camera", "good.yaml"]
#: Stands in for the result of a pipeline that is not run.
NO_MAP = make_result(None, Verdict.STATIC_CAMERA)
CAMERA = "model: pinhole\nwidth: 64\nheight: 48\nfx: 60\nfy: 60\ncx: 31.5\ncy: 23.5\n"
INITIALIZED, REFUSED = summarize(make_result(make_map())), summarize(NO_MAP)
