"""The wait: frames after the start until the first correct map."""

import math

import numpy as np
import pytest

from slam_init.compare.criteria import NOT_EVALUATED, Criteria
from slam_init.compare.figures import figures_of, table_of, wait_differences
from slam_init.compare.rows import TrialRow


def row(outcome, frames=None, *, source="a", method="quest", start=0, limit=11, **values):
    given = {"group": source, "frames_limit": limit, "evaluated_by": Criteria().rule} | values
    return TrialRow(source=source, method=method, start=start, outcome=outcome, frames_to_accept=frames, **given)


def test_a_correct_map_at_the_second_frame_has_a_wait_of_1_and_other_trials_count_as_their_limit():
    rows = [row("correct", 2), row("correct", 11), row("false", 2), row("none"), row("error", limit=3)]
    assert table_of(rows)["wait"].tolist() == [1, 10, 10, 10, 2]


def test_trials_that_no_map_can_solve_have_no_wait():
    rows = [
        row("false", 2, group="points:rotation"),
        row("false", 2, start=3, group="parrington"),
        row("accepted", 2, start=1, evaluated_by=None),
        row("none", start=2, evaluated_by=NOT_EVALUATED.rule),
    ]
    table = table_of(rows)
    assert table["wait"].isna().all()
    assert math.isnan(figures_of(table)["wait"].value)
    assert wait_differences(table, ("quest", "stella"))[0]["trials"] == 0


def test_a_difference_compares_the_same_trials_and_its_interval_the_sequences():
    rows = []
    for k, source in enumerate("abcd"):
        for start in (0, 10):
            rows.append(row("correct", 4 + k, source=source, start=start))
            rows.append(row("correct", 2, source=source, start=start, method="stella"))
    rows.append(row("correct", 2, source="e", method="stella"))  # quest did not run this trial
    table = table_of(rows)
    (difference,) = wait_differences(table, ("quest", "stella"))
    assert (difference["first"], difference["second"]) == ("quest", "stella")
    assert (difference["trials"], difference["sequences"]) == (8, 4)
    assert difference["difference_frames"].value == pytest.approx(np.mean([2, 3, 4, 5]))
    assert 2 <= difference["difference_frames"].low < 3.5 < difference["difference_frames"].high <= 5
    (swapped,) = wait_differences(table, ("stella", "quest"))
    assert swapped["difference_frames"].value == -difference["difference_frames"].value
