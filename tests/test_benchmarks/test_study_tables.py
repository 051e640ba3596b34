"""The tables of the study count its rows."""

from dataclasses import replace

from comparisons import table_cells

from slam_init.compare.rows import TrialRow
from tests.benchmarks.study_parts import Cell
from tests.benchmarks.study_tables import frames_to_correct, moving_table, static_table


def row(source, method, outcome, frames=None, **more):
    given = {"strict": outcome == "correct", "reason": "low_parallax" if outcome == "none" else None}
    return TrialRow(
        source=source, method=method, start=0, group="", outcome=outcome, frames_to_accept=frames, frames_limit=12,
        **given | more,
    )  # fmt: skip


def test_a_trial_without_a_correct_map_counts_as_its_limit():
    rows = [row("a", "m", "correct", 4), row("b", "m", "false", 3), row("c", "m", "none"), row("d", "m", "error")]
    assert frames_to_correct(rows) == [4.0, 12.0, 12.0, 12.0]


def test_methods_are_compared_on_the_same_worlds():
    """Of four worlds, both methods solve the first, each solves one of the next two, and no method solves the last."""
    outcomes = {"quest": ("correct", "correct", "none", "none"), "other": ("correct", "false", "correct", "none")}
    rows = {
        (source, method): row(source, method, outcome, 6 if method == "quest" else 3)
        for method, given in outcomes.items()
        for source, outcome in zip("abcd", given, strict=True)
    }
    rows["d", "quest"] = replace(rows["d", "quest"], reason="ambiguous_plane", kept_truth=True)
    ours, other, *together = table_cells(moving_table([Cell("wall", tuple("abcd"))], rows, ("quest", "other")))
    assert ours[:3] == ["wall", "quest", "4"]
    assert ours[3].startswith("50.0 [")
    assert ours[6:8] == ["2 (1 ambiguous_plane, 1 low_parallax)", "1 of 1"]
    # each method solves two of the three solvable worlds
    assert ours[8] == other[8]
    assert ours[8].startswith("66.7 [")
    # frames: 6 6 12 12 against 3 12 3 12
    assert (ours[9], other[9]) == ("9.00", "7.50")
    assert other[10].startswith("-1.50 [")
    assert [cells[2:] for cells in together] == [ours[2:], other[2:]]


def test_the_table_without_translation_counts_false_maps_reasons_and_suspicions():
    rows = {
        ("a", "quest"): row(
            "a", "quest", "none", reason="pure_rotation", reason_right=True, suspected_focal_factor=0.9
        ),
        ("b", "quest"): row("b", "quest", "false", 5, reason_right=False),
    }
    (cells,) = table_cells(static_table([Cell("rotation", ("a", "b"))], rows, ("quest",)))
    shares = [cell.partition(" ")[0] for cell in cells]
    assert shares[3:] == ["50.0", "1", "50.0", "50.0", "0.0"]
