"""The page of a comparison."""

from comparisons import METHODS

from slam_init.compare.plan import Plan
from slam_init.compare.run import compare
from slam_init.compare.sources import describe_sources


def test_the_page_loads_nothing_from_other_places(finished):
    page = (finished[0] / "report.html").read_text()
    assert page.startswith("<!DOCTYPE html>")
    for outside in ("http://", "https://", "<script src", "<link", "@import", "url(", "fetch(", "import("):
        assert outside not in page
    for method in METHODS:
        assert method in page


def test_the_page_tells_the_wait_and_how_each_scene_is_judged(finished):
    page = (finished[0] / "report.html").read_text()
    assert f"wait of {METHODS[0]} minus that of" in page
    assert "How each sequence is judged" in page
    for rule in ("rotation within 5 deg, direction within 15 deg", "every map is false"):
        assert rule in page


def test_a_comparison_without_any_map_has_a_page_as_well(tmp_path):
    plan = Plan(tuple(describe_sources(["points:static?views=3"])), ("failing_methods:Raises",))
    summary = compare(plan, tmp_path / "out", backend="sequential")
    assert summary.parts["points_static"]["failing_methods:Raises"].error == 1
    assert (tmp_path / "out" / "report.html").is_file()
