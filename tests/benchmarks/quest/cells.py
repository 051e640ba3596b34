"""Statistics of the answers of a method to a group of pairs, as cells of a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.benchmarks.quest.measures import accuracy, area_under_recall
from tests.benchmarks.quest.robust_trials import Answer

#: A pose with smaller errors counts as the true pose: the two poses of a plane are farther apart, and a bundle
#: adjustment converges from it.
FOUND_DEG = 5.0


def auc_cell(answers: Sequence[Answer]) -> str:
    """AUC at 5 / 10 / 20 deg in per cent."""
    errors = [answer.error_deg for answer in answers]
    return " / ".join(f"{100 * area_under_recall(errors, bound):.0f}" for bound in (5, 10, 20))


def kept_cell(answers: Sequence[Answer]) -> str:
    """Percentage of answers with a pose within 5 deg among the returned ones, and the mean number of returned poses."""
    if not answers:
        return "-"
    share = 100 * accuracy([answer.kept_error_deg for answer in answers], FOUND_DEG)
    return f"{share:.0f} ({np.mean([answer.kept for answer in answers]):.2f})"


def errors_cell(answers: Sequence[Answer]) -> str:
    """Median error of rotation / direction in deg, a failure counted as infinite.

    The median over the successes alone would favour a method that often gives up.
    """
    rotation = float(np.median([answer.rotation_error_deg for answer in answers]))
    direction = float(np.median([answer.direction_error_deg for answer in answers]))
    return f"{rotation:.3f} / " + ("-" if np.isnan(direction) else f"{direction:.2f}")


def times_cell(answers: Sequence[Answer]) -> str:
    """Median / 95th percentile of the times in ms."""
    times = [answer.time_ms for answer in answers]
    return f"{np.median(times):.1f} / {np.percentile(times, 95):.0f}"


def verdicts_cell(answers: Sequence[Answer]) -> str:
    """Percentage of answers "rotation-only camera" / no pose."""
    kinds = [answer.kind for answer in answers]
    return f"{100 * kinds.count('rotation') / len(kinds):.0f} / {100 * kinds.count('none') / len(kinds):.0f}"
