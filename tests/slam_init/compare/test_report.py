"""The page of a comparison."""

import re

import pytest
from comparisons import METHODS

from slam_init.compare.run import compare
from slam_init.compare.sources import describe_sources
from slam_init.compare.trials import Plan

pytestmark = pytest.mark.process


def test_the_page_loads_nothing_and_states_the_wait_and_how_each_scene_is_evaluated(finished):
    page = (finished[0] / "report.html").read_text()
    for message in (*METHODS, f"wait of {METHODS[0]} minus that of", "rotation within 5 deg", "every map is false"):
        assert message in page
    page = re.sub(r'xmlns(:\w+)?="[^"]*"|url\(#|href="#', "", page)
    for outside in ("http://", "https://", "<script", "<link", "@import", "url(", "src=", "href="):
        assert outside not in page


def test_a_comparison_without_any_map_has_a_page_as_well(tmp_path):
    plan = Plan(tuple(describe_sources(["points:static?views=3"])), ("failing_methods:Raises",))
    summary, _ = compare(plan, tmp_path / "out")
    assert summary["parts"]["points_static"]["failing_methods:Raises"]["error"] == 1
    assert (tmp_path / "out" / "report.html").is_file()
