"""The HTML tables of the report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from html import escape

import numpy as np

from slam_init.compare.aggregate import Figures, PairTest, pair_tests
from slam_init.compare.charts import share_bar
from slam_init.compare.html_table import html_table, row_heading
from slam_init.compare.judging import Criteria
from slam_init.compare.reliability import DIRECTION_SIGMAS, ROTATION_SIGMAS, Coverage, Reliability
from slam_init.compare.statistics import Interval
from slam_init.compare.trial_table import TrialTable
from slam_init.compare.wait import WaitDifference, waits
from slam_init.methods.external_command import method_label
from slam_init.types.arrays import Bools, Floats

_SIGNIFICANT = 0.05
_OUTCOMES = ("correct", "accepted", "false", "none", "error")
#: A column: heading, text of the cell, value to rank by (None: not ranked), whether a larger value is better.
_Column = tuple[str, Callable[[Figures], str], Callable[[Figures], float | None] | None, bool]


def rates_table(figures: Mapping[str, Figures]) -> str:
    """Make the main table of a part with a moving camera: rates of the outcomes, and time to the first map."""
    columns: list[_Column] = [
        ("outcomes", _outcome_bar, None, True),
        ("trials", lambda f: str(f.trials), None, True),
        ("correct %", lambda f: _share(f.correct_rate), lambda f: f.correct_rate.value, True),
        ("strict %", lambda f: _number(f.strict / f.trials if f.trials else None, 1, 100.0), None, True),
        ("false %", lambda f: _share(f.false_rate), lambda f: f.false_rate.value, False),
        ("precision %", lambda f: _share(f.precision), None, True),
        ("none", lambda f: str(f.none), None, True),
        ("ambiguous: correct<br>hypothesis kept %", _kept_truth, None, True),
        ("error", lambda f: str(f.error), None, True),
        ("frames to<br>first map", lambda f: _mean(f.frames_to_accept), None, False),
        ("wait<br>(frames)", lambda f: _mean(f.wait, 2), lambda f: f.wait.value, False),
        ("seconds to<br>first map", lambda f: _mean(f.seconds_to_accept, 2), None, False),
    ]
    return _table("outcomes and time by method", figures, columns)


def quality_table(figures: Mapping[str, Figures]) -> str:
    """Make the table of the quality of the correct maps, and of time and memory."""

    def _median(name: str, digits: int = 2, scale: float = 1.0) -> Callable[[Figures], str]:
        return lambda f: _number(f.medians[name], digits, scale)

    def _times(name: str) -> Callable[[Figures], str]:
        return lambda f: _number(f.times[name], 1)

    columns: list[_Column] = [
        ("rotation<br>(deg)", _median("rotation_error_deg"), lambda f: f.medians["rotation_error_deg"], False),
        ("before<br>BA", _median("rotation_error_before_deg"), None, False),
        ("direction<br>(deg)", _median("direction_error_deg"), lambda f: f.medians["direction_error_deg"], False),
        ("before<br>BA", _median("direction_error_before_deg"), None, False),
        ("ATE<br>%", _median("ate", 2, 100.0), None, False),
        ("before<br>BA", _median("ate_before", 2, 100.0), None, False),
        ("survival<br>%", _median("survival", 0, 100.0), lambda f: f.medians["survival"], True),
        ("depth<br>error %", _median("depth_error", 1, 100.0), lambda f: f.medians["depth_error"], False),
        ("depth order<br>error %", _median("depth_order_error", 1, 100.0), None, False),
        ("landmarks", _median("landmarks", 0), None, True),
        ("frame<br>(ms)", _times("frame_median_ms"), None, False),
        ("p95<br>(ms)", _times("frame_p95_ms"), None, False),
        ("attempt<br>(ms)", _times("attempt_median_ms"), None, False),
        ("peak<br>(MB)", lambda f: _number(f.peak_memory_mb, 0), None, False),
    ]
    return _table("quality of the correct maps, and time, by method", figures, columns)


def static_table(figures: Mapping[str, Figures]) -> str:
    """Make the main table of a part without translation (static or rotation-only camera)."""
    columns: list[_Column] = [
        ("outcomes", _outcome_bar, None, True),
        ("trials", lambda f: str(f.trials), None, True),
        ("false", lambda f: str(f.false), None, False),
        ("false %", lambda f: _share(f.false_rate), lambda f: f.false_rate.value, False),
        ("none", lambda f: str(f.none), None, True),
        ("error", lambda f: str(f.error), None, True),
        ("expected reason %", lambda f: _share(f.reason_accuracy), lambda f: f.reason_accuracy.value, True),
        ("focal error<br>suspected %", lambda f: _share(f.suspicion_rate), None, True),
        ("focal error<br>reported %", lambda f: _share(f.report_rate), None, True),
        ("focal error<br>false alarm %", lambda f: _share(f.false_report_rate), None, False),
        ("frame (ms)", lambda f: _number(f.times["frame_median_ms"], 1), None, False),
    ]
    return _table("outcomes by method without translation", figures, columns)


def group_table(table: TrialTable, methods: Sequence[str], thumbnails: Mapping[str, str]) -> str:
    """Make the table of scenes (rows) and methods (columns) with counts of correct, false and no maps, and the wait."""
    rows = []
    of_cell, outcomes, wait_of_trial = table.cells(), table.text["outcome"], waits(table)
    nothing = np.zeros(0, np.int64)
    for group in sorted(set(table.text["group"].tolist())):
        cells = []
        for method in methods:
            trials = of_cell.get((group, method), nothing)
            counts = Counter(outcomes[trials].tolist())
            bar = share_bar([(name, counts[name]) for name in _OUTCOMES])
            figures = (
                f"{counts['correct'] + counts['accepted']} / {counts['false']} / {counts['none'] + counts['error']}"
            )
            cells.append(f"<td>{bar}{figures}{_wait_of_cell(wait_of_trial[trials])}</td>")
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
        f"<td{_sign_class(d.difference_frames)}>{_mean(d.difference_frames, 2)}</td></tr>"
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
        bins = [(f"{one.low:g} to {one.high:g}", one) for one in reliability.bins if one.maps]
        for k, (name, one) in enumerate([*bins, ("all", reliability.total)]):
            head = row_heading(method_label(method), len(bins) + 1) if k == 0 else ""
            understated = ' class="lose"' if one.false_rate.low > one.mean_risk else ""
            rows.append(
                f"<tr>{head}<td>{name}</td><td>{one.maps}</td><td>{_number(one.mean_risk, 3, 100.0)}</td>"
                f"<td>{_number(one.expected_false, 3)}</td><td>{one.false}</td>"
                f"<td{understated}>{_share(one.false_rate, 2)}</td></tr>"
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
    return f"<td>{coverage.maps}</td><td>{_share(coverage.rate)}</td>"


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
    """Make the table of paired comparisons: trials that only one of two methods solves, and p-values.

    Shapes: ``mask`` (N,).
    """
    tests = {(test.first, test.second): test for test in pair_tests(table, methods, mask)}
    rows = []
    for first in methods:
        cells = []
        for second in methods:
            if first == second:
                cells.append("<td>&middot;</td>")
            elif (first, second) in tests:
                cells.append(_pair_cell(tests[first, second], swapped=False))
            else:
                cells.append(_pair_cell(tests[second, first], swapped=True))
        rows.append(f"<tr>{row_heading(method_label(first))}{''.join(cells)}</tr>")
    headings = ["only row : only column", *(escape(method_label(method)) for method in methods)]
    return html_table("trials that only one of two methods solves", headings, rows, "matrix")


def _pair_cell(test: PairTest, *, swapped: bool) -> str:
    row, column = test.only_first_correct, test.only_second_correct
    if swapped:
        row, column = column, row
    p = test.p_correct_holm
    kind = "" if p >= _SIGNIFICANT else ' class="win"' if row > column else ' class="lose"'
    return f'<td{kind}>{row} : {column}<span class="interval">p {_p_value(p)}</span></td>'


def _p_value(p: float) -> str:
    return "&lt; 0.001" if p < 1e-3 else f"= {p:.2g}"


def _table(caption: str, figures: Mapping[str, Figures], columns: Sequence[_Column]) -> str:
    columns = [column for column in columns if any(column[1](f) != "-" for f in figures.values())]
    best = [_best(figures, rank, more) for _, _, rank, more in columns]
    rows = []
    for i, (method, of_method) in enumerate(figures.items()):
        cells = [
            f"<td{' class=best' if method in winners else ''}>{cell(of_method)}</td>"
            for (_, cell, _, _), winners in zip(columns, best, strict=True)
        ]
        ours = ' class="ours"' if i == 0 else ""
        rows.append(f"<tr{ours}>{row_heading(method_label(method))}{''.join(cells)}</tr>")
    return html_table(caption, ["method", *(heading for heading, *_ in columns)], rows)


def _best(
    figures: Mapping[str, Figures], rank: Callable[[Figures], float | None] | None, more_is_better: bool
) -> set[str]:
    """Return the methods that are best in a column; empty if all are equal."""
    if rank is None:
        return set()
    values = {method: value for method, f in figures.items() if (value := rank(f)) is not None and value == value}
    if len(set(values.values())) < 2:
        return set()
    top = max(values.values()) if more_is_better else min(values.values())
    return {method for method, value in values.items() if value == top}


def _outcome_bar(f: Figures) -> str:
    not_strict = f.correct - f.strict
    not_compared = f.accepted - f.correct - f.false
    counts = (f.strict, not_strict, not_compared, f.false, f.none, f.error)
    return share_bar(list(zip(("strict", "correct", "accepted", "false", "none", "error"), counts, strict=True)))


def _kept_truth(f: Figures) -> str:
    """Return the share of the ambiguous planes in which one of the stored hypotheses is correct."""
    return _share(f.kept_truth_rate).replace("<span", f" of {f.undecided}<span", 1) if f.undecided else "-"


def _share(interval: Interval, digits: int = 1) -> str:
    if interval.value != interval.value:
        return "-"
    low, high = 100 * interval.low, 100 * interval.high
    ends = f'<span class="interval">{low:.{digits}f} to {high:.{digits}f}</span>'
    return f"{100 * interval.value:.{digits}f}{ends}"


def _mean(interval: Interval, digits: int = 1) -> str:
    if interval.value != interval.value:
        return "-"
    known = interval.low == interval.low
    more = f'<span class="interval">{interval.low:.{digits}f} to {interval.high:.{digits}f}</span>' if known else ""
    return f"{interval.value:.{digits}f}{more}"


def _number(value: float | None, digits: int, scale: float = 1.0) -> str:
    return "-" if value is None else f"{scale * value:.{digits}f}"
