"""The HTML tables of the report that are not tables of methods and figures (:mod:`slam_init.compare.tables`)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from html import escape

import numpy as np

from slam_init.compare.aggregate import PairTest, pair_tests
from slam_init.compare.judging import Criteria
from slam_init.compare.reliability import DIRECTION_SIGMAS, ROTATION_SIGMAS, Coverage, Reliability
from slam_init.compare.statistics import Interval
from slam_init.compare.tables import HTML_ENDS, figure_text, html_table, p_value_text, row_heading, share_bar
from slam_init.compare.trial_table import TrialTable
from slam_init.compare.wait import WaitDifference, waits
from slam_init.methods.external_command import method_label
from slam_init.types.arrays import Bools, Floats

_SIGNIFICANT = 0.05
_OUTCOMES = ("correct", "accepted", "false", "none", "error")
_html = partial(figure_text, ends=HTML_ENDS)


def group_table(table: TrialTable, methods: Sequence[str], thumbnails: Mapping[str, str]) -> str:
    """Make the table of scenes (rows) and methods (columns) with counts of correct, false and no maps, and the wait."""
    rows = []
    of_cell, outcomes, wait_of_trial = table.cells(), table.text["outcome"], waits(table)
    nothing = np.zeros(0, np.int64)
    for group in sorted(set(table.text["group"].tolist())):
        cells = []
        for method in methods:
            trials = of_cell.get((group, method), nothing)
            n = Counter(outcomes[trials].tolist())
            bar = share_bar([(name, n[name]) for name in _OUTCOMES])
            counts = f"{n['correct'] + n['accepted']} / {n['false']} / {n['none'] + n['error']}"
            cells.append(f"<td>{bar}{counts}{_wait_of_cell(wait_of_trial[trials])}</td>")
        picture = ""
        if group in thumbnails:
            picture = f'<img class="thumb" alt="" src="data:image/jpeg;base64,{thumbnails[group]}">'
        rows.append(f'<tr><th scope="row">{picture}{escape(group)}</th>{"".join(cells)}</tr>')
    headings = ["scene", *(escape(method_label(method)) for method in methods)]
    return html_table("outcomes by scene and method", headings, rows, "matrix")


def _wait_of_cell(waits_of_trials: Floats) -> str:
    known = waits_of_trials[np.isfinite(waits_of_trials)]
    return f'<span class="interval">wait {known.mean():.2f}</span>' if len(known) else ""


def wait_table(differences: Sequence[WaitDifference]) -> str:
    """Make the table of the waits of the first method compared with those of each other method."""
    if not differences:
        return ""
    first = method_label(differences[0].first)
    rows = [
        f"<tr>{row_heading(method_label(d.second))}<td>{d.trials}</td><td>{d.sequences}</td>"
        f"<td{_sign_class(d.difference_frames)}>{_html(d.difference_frames, 2)}</td></tr>"
        for d in differences
    ]
    headings = [f"wait of {escape(first)} minus that of", "trials", "sequences", "frames"]
    return html_table(f"wait of {first} minus that of each other method", headings, rows)


def _sign_class(difference: Interval) -> str:
    """Return the colour of a difference whose interval does not hold zero. A shorter wait is better."""
    return ' class="win"' if difference.high < 0 else ' class="lose"' if difference.low > 0 else ""


def risk_table(by_method: Mapping[str, Reliability]) -> str:
    """Make the table of the stated risks: for each method a row for each bin with maps, and a row for all maps."""
    rows = []
    for method, reliability in by_method.items():
        named = reliability.named_bins()
        for k, (name, one) in enumerate(named):
            head = row_heading(method_label(method), len(named)) if k == 0 else ""
            understated = ' class="lose"' if one.false_rate.low > one.mean_risk else ""
            rows.append(
                f"<tr>{head}<td>{name}</td><td>{one.maps}</td><td>{_html(one.mean_risk, 3, 100)}</td>"
                f"<td>{_html(one.expected_false, 3)}</td><td>{one.false}</td>"
                f"<td{understated}>{_html(one.false_rate, 2, 100)}</td></tr>"
            )
    headings = ["method", "stated risk", "maps", "mean stated<br>risk %", "expected<br>false maps"]
    return html_table("stated risks and false maps", [*headings, "false maps", "false %"], rows)


def coverage_table(by_method: Mapping[str, Reliability]) -> str:
    """Make the table of the coverage of the stated standard deviations."""
    rows = [
        f"<tr>{row_heading(method_label(method))}{_coverage_cells(one.direction)}{_coverage_cells(one.rotation)}</tr>"
        for method, one in by_method.items()
    ]
    headings = ["method", "maps", f"direction within<br>{DIRECTION_SIGMAS:.2f} deviations %"]
    headings += ["maps", f"rotation within<br>{ROTATION_SIGMAS:.2f} deviations %"]
    return html_table("coverage of the stated standard deviations", headings, rows)


def _coverage_cells(coverage: Coverage) -> str:
    return f"<td>{coverage.maps}</td><td>{_html(coverage.rate, 1, 100)}</td>"


def judging_table(judging: Mapping[str, Criteria]) -> str:
    """Make the table of how each sequence is judged."""
    rows = [
        f"<tr>{row_heading(group)}<td>{criteria.truth}</td><td>{escape(criteria.rule)}</td>"
        f"<td>{criteria.expected_reason or '-'}</td><td>{escape(criteria.note or '-')}</td></tr>"
        for group, criteria in judging.items()
    ]
    headings = ["scene", "ground truth", "correct", "expected reason", "because"]
    return html_table("how each sequence is judged", headings, rows, "words")


def pair_table(table: TrialTable, methods: Sequence[str], mask: Bools) -> str:
    """Make the table of paired comparisons: p-values, and trials that only one of two methods solves: ``mask`` (N,)."""
    tests = {(test.first, test.second): test for test in pair_tests(table, methods, mask)}
    rows = []
    for first in methods:
        cells = ["<td>&middot;</td>" if first == second else _pair_cell(tests, first, second) for second in methods]
        rows.append(f"<tr>{row_heading(method_label(first))}{''.join(cells)}</tr>")
    headings = ["only row : only column", *(escape(method_label(method)) for method in methods)]
    return html_table("trials that only one of two methods solves", headings, rows, "matrix")


def _pair_cell(tests: Mapping[tuple[str, str], PairTest], of_row: str, of_column: str) -> str:
    test = tests.get((of_row, of_column)) or tests[of_column, of_row]
    row, column = test.only_first_correct, test.only_second_correct
    if test.first != of_row:
        row, column = column, row
    p = test.p_correct_holm
    kind = "" if p >= _SIGNIFICANT else ' class="win"' if row > column else ' class="lose"'
    p_value = f"p {'' if p < 1e-3 else '= '}{p_value_text(p)}"
    return f'<td{kind}>{row} : {column}<span class="interval">{escape(p_value)}</span></td>'
