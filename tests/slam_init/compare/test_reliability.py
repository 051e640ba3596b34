"""The stated risk compared with the share of false maps."""

import json
from itertools import pairwise

import numpy as np
import pytest
from comparisons import table_cells
from hypothesis import given
from hypothesis import strategies as st

from slam_init.compare.command import main_table
from slam_init.compare.judging import NOT_JUDGED, criteria_of
from slam_init.compare.plan import Plan
from slam_init.compare.reliability import DIRECTION_SIGMAS, RISK_EDGES, ROTATION_SIGMAS, reliabilities, reliability_of
from slam_init.compare.report import report_html
from slam_init.compare.rows import TrialRow, parse_row, row_text
from slam_init.compare.sources import describe_sources
from slam_init.compare.statistics import wilson
from slam_init.compare.summary import summary_of
from slam_init.compare.trial_table import TrialTable

TITLE = "Reliability of the stated risk"
NEW_COLUMNS = (
    "risk", "rotation_sigma_deg", "direction_sigma_deg", "pair_rotation_error_deg", "pair_direction_error_deg",
)  # fmt: skip


def row(risk, outcome="correct", *, method="quest", group="points:room", start=0, **values):
    given = {"source": group, "frames_limit": 11, "judged_by": criteria_of(group).rule, "keyframes": "0 1"} | values
    return TrialRow(method=method, group=group, start=start, outcome=outcome, risk=risk, **given)


def reliability(*rows):
    return reliability_of(TrialTable.read(rows))


@given(st.lists(st.tuples(st.sampled_from(RISK_EDGES) | st.floats(0, 1), st.booleans()), min_size=1, max_size=40))
def test_the_bins_partition_the_maps_and_the_expected_number_of_false_maps_is_the_sum_of_the_risks(maps):
    found = reliability(*(row(risk, "false" if false else "correct") for risk, false in maps))
    assert [(one.low, one.high) for one in found.bins] == list(pairwise(RISK_EDGES))
    for one in found.bins:
        inside = [(risk, false) for risk, false in maps if one.low < risk <= one.high or risk == one.low == 0]
        assert one.maps == len(inside)
        assert one.false == sum(false for _, false in inside)
        assert one.false_rate == wilson(one.false, one.maps) or one.maps == 0
        assert one.expected_false == pytest.approx(sum(risk for risk, _ in inside))
        if inside:
            assert one.mean_risk == pytest.approx(np.mean([risk for risk, _ in inside]))
    assert sum(one.maps for one in found.bins) == found.total.maps == len(maps)
    assert sum(one.false for one in found.bins) == found.total.false
    assert found.total.expected_false == pytest.approx(sum(risk for risk, _ in maps))


@pytest.mark.parametrize(
    "uncounted",
    [
        row(None, method="poselib"),
        row(None, "none"),
        row(0.001, group="fr1_desk_9frames"),  # coarse
        row(0.001, group="redkitchen_a"),  # rotations only
        row(0.001, "false", group="parrington"),
        row(0.001, "accepted", group="unknown", judged_by=NOT_JUDGED.rule),
    ],
)
def test_only_maps_with_a_stated_risk_and_a_sound_truth_are_counted(uncounted):
    assert reliability(uncounted) is None
    counted = row(0.002, "false")
    assert reliability(uncounted, counted) == reliability(counted)


def test_methods_that_state_no_risk_are_absent_and_images_are_separate_from_points():
    rows = [
        row(0.001),
        row(None, method="poselib"),
        row(0.004, "false", group="points:rotation"),
        row(0.002, group="a"),
    ]
    found = reliabilities(TrialTable.read(rows), ("poselib", "quest"))
    assert {level: list(by_method) for level, by_method in found.items()} == {"image": ["quest"], "points": ["quest"]}
    assert (found["image"]["quest"].total.maps, found["points"]["quest"].total.maps) == (1, 2)
    assert found["points"]["quest"].total.false == 1
    assert reliabilities(TrialTable.read([row(None)]), ("quest",)) == {}


def test_an_error_is_covered_up_to_the_stated_number_of_standard_deviations():
    def stated(direction, rotation, **values):
        errors = {"pair_direction_error_deg": direction * 0.5, "pair_rotation_error_deg": rotation * 0.1}
        return row(0.001, direction_sigma_deg=0.5, rotation_sigma_deg=0.1, **errors | values)

    inside, outside = 0.99, 1.01
    found = reliability(
        stated(inside * DIRECTION_SIGMAS, inside * ROTATION_SIGMAS),
        stated(outside * DIRECTION_SIGMAS, inside * ROTATION_SIGMAS),
        stated(outside * DIRECTION_SIGMAS, outside * ROTATION_SIGMAS, outcome="false"),
        # Not known, and a camera that does not translate: counted in the bins only.
        stated(0.0, 0.0, pair_direction_error_deg=None, pair_rotation_error_deg=None),
        stated(90.0, 0.0, outcome="false", group="points:rotation"),
    )
    assert (found.direction.within, found.direction.maps) == (1, 3)
    assert (found.rotation.within, found.rotation.maps) == (2, 3)
    assert found.direction.rate == wilson(1, 3)
    assert found.total.maps == 5


def test_the_numbers_of_deviations_hold_95_percent_of_gaussian_errors():
    rng = np.random.default_rng(0)
    for deviations, freedom in ((DIRECTION_SIGMAS, 2), (ROTATION_SIGMAS, 3)):
        errors = np.linalg.norm(rng.normal(size=(200_000, freedom)), axis=1)
        assert np.mean(errors <= deviations) == pytest.approx(0.95, abs=0.002)


def test_a_row_without_the_columns_of_the_risk_is_read_and_states_no_risk():
    values = dict.fromkeys(NEW_COLUMNS, 0.5)
    stored = json.loads(row_text(row(values.pop("risk"), **values)))
    for name in NEW_COLUMNS:
        del stored[name]
    former = parse_row(json.dumps(stored))
    assert former == row(None)
    assert reliability(former) is None


def test_the_tables_hold_a_row_for_each_bin_with_maps_and_one_for_all_maps():
    plan = Plan(tuple(describe_sources(["points:room"])), ("quest", "poselib"))
    rows = [row(None, method="poselib"), row(0.0005, start=1), row(0.004, "false", start=2), row(0.003, start=3)]
    *_, table = main_table(summary_of(TrialTable.read(rows), plan)).split("\n\n")
    assert [cells[:6] for cells in table_cells(table)] == [
        ["quest", "0 to 0.001", "1", "0.050", "0.001", "0"],
        ["quest", "0.002 to 0.005", "2", "0.350", "0.007", "1"],
        ["quest", "all", "3", "0.250", "0.007", "1"],
    ]


def test_the_page_and_the_summary_hold_the_section_only_if_a_method_states_a_risk():
    plan = Plan(tuple(describe_sources(["points:room"])), ("quest", "poselib"))
    without = [row(None, method=method) for method in plan.methods]
    table = TrialTable.read(without)
    summary = summary_of(table, plan)
    assert TITLE not in report_html(table, summary, plan, "")
    assert summary.as_dict()["reliability"] == {}

    table = TrialTable.read([*without, row(0.0005, start=1), row(0.004, "false", start=2), row(0.003, start=3)])
    summary = summary_of(table, plan)
    page = report_html(table, summary, plan, "")
    assert page.count(TITLE) == 1
    assert "href=#reliability" in page
    section = page[page.index('id="reliability"') : page.index('id="scenes"')]
    assert section.count("<circle") == 2  # two bins with maps
    assert "nan" not in section
    written = summary.as_dict()["reliability"]
    assert list(written) == ["points"]
    assert list(written["points"]) == ["quest"]
    assert written["points"]["quest"]["total"]["expected_false"] == 0.0075
    assert written["points"]["quest"]["bins"][1] == {
        "low": 0.001, "high": 0.002, "maps": 0, "mean_risk": None, "expected_false": 0.0, "false": 0,
        "false_rate": [None, None, None],
    }  # fmt: skip
