"""The recording of all methods side by side."""

from comparisons import METHODS, SOURCES
from read_recording import entities, rerun_tool

from slam_init.compare.plan import Plan
from slam_init.compare.run import compare
from slam_init.compare.sources import describe_sources


def test_the_recording_is_valid_and_equal_for_equal_trials(tmp_path):
    found = []
    for name in ("a", "b"):
        plan = Plan(tuple(describe_sources(SOURCES[:1])), METHODS[:2])
        compare(plan, tmp_path / name, backend="sequential", recordings=True)
        found.append(next((tmp_path / name).rglob("side-by-side.rrd")))
    assert rerun_tool("verify", found[0]).returncode == 0
    assert rerun_tool("compare", "--unordered", *found).returncode == 0
    shown = set(entities(found[0]))
    for entity in ("/frame/image", "/method-00/map/points", "/method-00/verdict", "/method-01/verdict"):
        assert entity in shown
