"""The stated risk compared with the share of false maps."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam_init.compare import figures
from slam_init.compare.criteria import NOT_EVALUATED, criteria_of
from slam_init.compare.figures import RISK_EDGES, reliability_of, summary_of, table_of
from slam_init.compare.rows import TrialRow
from slam_init.compare.sources import describe_sources
from slam_init.compare.statistics import wilson
from slam_init.compare.trials import Plan

pytestmark = pytest.mark.process


def row(risk, outcome="correct", *, method="quest", group="points:room", start=0, **values):
    given = {"source": group, "frames_limit": 11, "evaluated_by": criteria_of(group).rule, "keyframes": "0 1"} | values
    return TrialRow(method=method, group=group, start=start, outcome=outcome, risk=risk, **given)


def reliability(*rows):
    return reliability_of(table_of(rows))


@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(RISK_EDGES) | st.floats(0, 1), st.booleans()), min_size=1, max_size=40))
def test_the_bins_partition_the_maps_and_the_expected_number_of_false_maps_is_the_sum_of_the_risks(maps):
    found = reliability(*(row(risk, "false" if false else "correct") for risk, false in maps))
    assert [(one["low"], one["high"]) for one in found["bins"]] == list(pairwise(RISK_EDGES))
    for one in (*found["bins"], found["total"]):
        inside = [(risk, false) for risk, false in maps if one["low"] < risk <= one["high"] or risk == one["low"] == 0]
        assert (one["maps"], one["false"]) == (len(inside), sum(false for _, false in inside))
        assert one["false_rate"] == wilson(one["false"], one["maps"]) or one["maps"] == 0
        assert one["expected_false"] == pytest.approx(sum(risk for risk, _ in inside))
        if inside:
            assert one["mean_risk"] == pytest.approx(np.mean([risk for risk, _ in inside]))
    assert sum(one["maps"] for one in found["bins"]) == found["total"]["maps"] == len(maps)


def test_only_maps_with_a_stated_risk_and_a_sound_truth_are_counted():
    counted = row(0.002, "false")
    for uncounted in (
        row(None, method="poselib"),
        row(None, "none"),
        row(0.001, group="fr1_desk_9frames"),  # coarse
        row(0.001, group="redkitchen_a"),  # rotations only
        row(0.001, "false", group="parrington"),
        row(0.001, "accepted", group="unknown", evaluated_by=NOT_EVALUATED.rule),
    ):
        assert reliability(uncounted) is None
        assert reliability(uncounted, counted) == reliability(counted)


def test_methods_that_state_no_risk_are_absent_and_images_are_separate_from_points():
    plan = Plan(tuple(describe_sources(["points:room"])), ("poselib", "quest"))
    rows = [row(0.001), row(None, method="poselib"), row(0.002, group="a")]
    rows.append(row(0.004, "false", group="points:rotation"))
    found = summary_of(table_of(rows), plan)["reliability"]
    assert {level: list(by_method) for level, by_method in found.items()} == {"image": ["quest"], "points": ["quest"]}
    assert (found["image"]["quest"]["total"]["maps"], found["points"]["quest"]["total"]["maps"]) == (1, 2)
    assert found["points"]["quest"]["total"]["false"] == 1
    assert summary_of(table_of([row(None)]), plan)["reliability"] == {}


def test_an_error_is_covered_up_to_the_stated_number_of_standard_deviations():
    def stated(direction, rotation, **values):
        errors = {"pair_direction_error_deg": direction * 0.5, "pair_rotation_error_deg": rotation * 0.1}
        return row(0.001, direction_sigma_deg=0.5, rotation_sigma_deg=0.1, **errors | values)

    inside, outside = 0.99, 1.01
    found = reliability(
        stated(inside * figures.DIRECTION_SIGMAS, inside * figures.ROTATION_SIGMAS),
        stated(outside * figures.DIRECTION_SIGMAS, inside * figures.ROTATION_SIGMAS),
        stated(outside * figures.DIRECTION_SIGMAS, outside * figures.ROTATION_SIGMAS, outcome="false"),
        # Not known, and a camera that does not translate: counted in the bins only.
        stated(0.0, 0.0, pair_direction_error_deg=None, pair_rotation_error_deg=None),
        stated(90.0, 0.0, outcome="false", group="points:rotation"),
    )
    assert (found["direction"]["within"], found["direction"]["maps"]) == (1, 3)
    assert (found["rotation"]["within"], found["rotation"]["maps"]) == (2, 3)
    assert found["direction"]["rate"] == wilson(1, 3)
    assert found["total"]["maps"] == 5
