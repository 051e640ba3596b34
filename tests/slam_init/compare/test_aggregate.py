"""The figures of a comparison count its rows."""

from slam_init.compare.figures import figures_of
from slam_init.compare.rows import TrialRow
from slam_init.compare.trial_table import TrialTable


def test_suspected_and_reported_focal_errors_are_counted_and_a_report_on_the_true_focal_length_is_a_false_alarm():
    def row(source, suspected=None, reported=None):
        return TrialRow(
            source=source, method="quest", group="points:rotation", start=0, outcome="none",
            reason="pure_rotation", strict=False, reason_right=True, frames_limit=12,
            suspected_focal_factor=suspected, reported_focal_factor=reported,
        )  # fmt: skip

    wrong, right = "points:rotation?focal_error=0.05", "points:rotation"
    rows = [row(wrong), row(wrong, 0.96), row(wrong, 0.95, 0.95), row(right, 0.95, 0.95)]
    table = TrialTable.read(rows)
    figures = figures_of(table.of_method("quest"))
    shares = [figures.suspicion_rate, figures.report_rate, figures.false_report_rate]
    assert [round(share.value, 2) for share in shares] == [0.67, 0.33, 1.0]
