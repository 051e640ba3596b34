"""``report.html``: a single page that loads nothing from other places. Its script only copies tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from slam_init.compare.charts import Axis, box_chart, curve_chart, interval_chart, stacked_chart
from slam_init.compare.figures import Figures, figures_of, wait_differences
from slam_init.compare.gallery import gallery_section, thumbnails, waiting_section
from slam_init.compare.reliability import Reliability, reliabilities
from slam_init.compare.statistics import Interval
from slam_init.compare.tables import (
    QUALITY,
    RATES,
    STATIC,
    coverage_table,
    group_table,
    html_figures,
    judging_table,
    page_html,
    pair_table,
    risk_table,
    wait_table,
)
from slam_init.compare.trial_table import LEVELS, PARTS, TrialTable
from slam_init.methods import METHODS
from slam_init.methods.external_command import method_label
from slam_init.types.arrays import Bools, Floats

if TYPE_CHECKING:
    from slam_init.compare.plan import Plan

#: Number of colours of the page (``report.css``).
_METHOD_COLORS = 22
#: Number of colours of reasons.
_COLORS = 10
#: Ranges of the axes of errors, in degrees.
_ROTATION_DEG, _DIRECTION_DEG = (0.01, 180.0), (0.1, 180.0)
#: Range of the axes of risks.
_RISK_PERCENT = (0.01, 100.0)
_OUTCOMES = ("strict", "correct", "false", "none", "error")


@dataclass(frozen=True, eq=False)
class _Part:
    """Trials that are counted together."""

    name: str
    title: str
    mask: Bools
    figures: dict[str, Figures]

    @property
    def no_translation(self) -> bool:
        return self.name.endswith("static")


def report_html(table: TrialTable, plan: Plan, command: str) -> str:
    """Make the page."""
    parts = [
        _Part(
            name,
            PARTS[name],
            mask,
            {method: figures_of(table, mask & table.where(method=method)) for method in plan.methods},
        )
        for name, mask in table.parts().items()
    ]
    reliability = reliabilities(table, plan.methods)
    colors = method_colors(plan.methods)
    body = [_header(table, plan, command, parts, stated_risk=bool(reliability))]
    for part in parts:
        body.append(_static_section(part) if part.no_translation else _moving_section(table, plan, part, colors))
    if reliability:
        body.append(_reliability_section(reliability, colors))
    body += [
        _groups_section(table, plan),
        _judging_section(plan),
        gallery_section(table, plan),
        waiting_section(table, plan),
    ]
    body.append(_footer(plan))
    return page_html("slam-init compare", body)


def _header(table: TrialTable, plan: Plan, command: str, parts: Sequence[_Part], *, stated_risk: bool) -> str:
    false = int(np.sum(table.text["outcome"] == "false"))
    facts = [
        (f"{len(table):,}", "trials"),
        (str(len(plan.methods)), "methods"),
        (f"{len(plan.sources):,}", "sources"),
        (f"{false:,}", "false maps"),
        (str(plan.settings.seed), "seed"),
    ]
    links = [(part.name, part.title) for part in parts]
    links += [("reliability", "stated risk")] if stated_risk else []
    links += [("scenes", "by scene"), ("judging", "how judged"), ("worst", "worst cases"), ("waiting", "no map")]
    return (
        "<h1>Monocular initializers on the same tracks</h1>"
        '<p class="soft">Each trial starts a method at a frame and ends at its first map, or after '
        f"{plan.settings.limit_frames} frames or {plan.settings.limit_s:g} s of video. "
        "All methods get the same tracks.</p>"
        f'<div class="facts">{"".join(f"<div><b>{n}</b>{unit}</div>" for n, unit in facts)}</div>'
        f"<nav>{''.join(f'<a href=#{name}>{escape(title)}</a>' for name, title in links)}</nav>"
        + (f"<pre><code>{escape(command)}</code></pre>" if command else "")
        + _legend([(name, name) for name in _OUTCOMES])
    )


# -- one part --------------------------------------------------------------------------------------


def _moving_section(table: TrialTable, plan: Plan, part: _Part, colors: dict[str, str]) -> str:
    return (
        f'<h2 id="{part.name}">{escape(part.title[0].upper() + part.title[1:])}</h2>'
        '<p class="soft">Shares have 95 % intervals (Wilson). Frames are restricted means: a trial without a map (or '
        "without a correct map) counts as its limit. Ambiguous: the trials that ended with an ambiguous plane, and the "
        "share in which one of the stored hypotheses is correct. Errors are medians over the correct maps. The best "
        "value of a column is bold.</p>"
        + html_figures("outcomes and time by method", part.figures, RATES, bar=True)
        + "<h3>Quality of the correct maps, and time</h3>"
        + html_figures("quality of the correct maps, and time, by method", part.figures, QUALITY)
        + _legend([(colors[method], method_label(method)) for method in plan.methods])
        + f'<div class="charts">{"".join(_charts(table, plan, part, colors))}</div>'
        + "<h3>On the same trials</h3>"
        '<p class="soft">Each cell compares two methods: the number of trials in which only the method of the row, and '
        "only the method of the column, finds a correct map; below, the p-value of McNemar's exact test, adjusted for "
        "the number of pairs (Holm). A cell is coloured if the p-value is below 0.05.</p>"
        + pair_table(table, plan.methods, part.mask)
        + '<p class="soft">Difference of the waits, trial by trial: a negative difference means that '
        f"{escape(method_label(plan.methods[0]))} has a correct map earlier. The intervals come from a bootstrap over "
        "sequences, because trials of one sequence overlap. They are too narrow for fewer than about ten sequences. A "
        "cell is coloured if its interval does not hold zero.</p>"
        + wait_table(wait_differences(table, plan.methods, part.mask))
    )


def _charts(table: TrialTable, plan: Plan, part: _Part, colors: dict[str, str]) -> list[str]:
    outcome = table.text["outcome"]
    frames = table.numbers["frames_to_accept"]
    limit = max(float(np.max(table.numbers["frames_limit"][part.mask])), 2.0)
    time = Axis("frames since the start", 0, limit)
    masks = {method: part.mask & table.where(method=method) for method in plan.methods}
    correct, false = (
        {
            colors[method]: _cumulative(frames[mask & (outcome == kind)], int(mask.sum()))
            for method, mask in masks.items()
        }
        for kind in ("correct", "false")
    )
    most_false = max((float(y[-1]) for _, y in false.values() if len(y)), default=0.0)
    charts = []
    for name, kind, curves, top in (
        ("Delay: correct maps over time", "correct", correct, 1.0),
        ("False maps over time", "false", false, _above(most_false)),
    ):
        title = _described(f"{kind} maps over time", curves, colors)
        chart = curve_chart(title, curves, time, Axis("share of trials", 0, top), [])
        charts.append((name, f"Share of the trials that have a {kind} map at this frame.", chart))
    for column, name, (low, high), bounds in (
        ("rotation_error_deg", "Rotation error", _ROTATION_DEG, (1, 5)),
        ("direction_error_deg", "Direction error", _DIRECTION_DEG, (5, 15)),
    ):
        values = table.numbers[column]
        # Trials whose ground truth does not resolve the direction have no direction error.
        known = table.knows_direction() if column == "direction_error_deg" else np.ones(len(table), bool)
        curves = {
            colors[method]: _cumulative(np.clip(_known(values[mask & known]), low, high), int(np.sum(mask & known)))
            for method, mask in masks.items()
        }
        note = "Share of the trials whose map has at most this error. Dashed lines: the bounds of strict and correct."
        axis = Axis(f"worst keyframe (degrees), strict {bounds[0]}, correct {bounds[1]}", low, high, log=True)
        charts.append(
            (
                name,
                note,
                curve_chart(_described(name, curves, colors), curves, axis, Axis("share of trials", 0, 1), bounds),
            )
        )
    boxes = [
        (method_label(method), colors[method], _known(frames[mask & (outcome == "correct")]))
        for method, mask in masks.items()
    ]
    charts.append(
        ("Frames to a correct map", "Trials with a correct map: median, quartiles, 5th and 95th percentile.",
         box_chart("frames to a correct map", boxes, time))
    )  # fmt: skip
    return [_figure(*chart) for chart in charts] + [_reasons(part)]


def _described(title: str, curves: Mapping[str, tuple[Floats, Floats]], colors: Mapping[str, str]) -> str:
    """Return the label of a chart for screen readers: where each curve ends."""
    ends = [(method_label(method), curves[color][1]) for method, color in colors.items() if color in curves]
    return f"{title}; at the end " + ", ".join(f"{name} {100 * ys[-1] if len(ys) else 0:.0f} %" for name, ys in ends)


def _static_section(part: _Part) -> str:
    return (
        f'<h2 id="{part.name}">{escape(part.title[0].upper() + part.title[1:])}</h2>'
        '<p class="soft">The camera never translates, so every map is false. The expected reason is static_camera or '
        "pure_rotation. Focal error: of the trials whose stated focal length is wrong on purpose, the share in which "
        "an attempt suspects it, and the share in which the result reports it. False alarm: of the trials with the "
        "true focal length, the share in which the result reports that it is wrong.</p>"
        + html_figures("outcomes by method without translation", part.figures, STATIC, bar=True)
        + f'<div class="charts">{_reasons(part)}</div>'
    )


def _reasons(part: _Part) -> str:
    """Draw the shares of the reasons for which there is no map, with one bar per method."""
    names = list(dict.fromkeys(reason for f in part.figures.values() for reason, n in f.reasons.items() if n))
    names.sort(key=lambda name: -sum(f.reasons.get(name, 0) for f in part.figures.values()))
    shown = names[: _COLORS - 1]
    rows = []
    for method, f in part.figures.items():
        pieces = [(f"r{i}", 100 * f.reasons.get(name, 0) / max(f.trials, 1)) for i, name in enumerate(shown)]
        rest = sum(f.reasons.get(name, 0) for name in names[_COLORS - 1 :])
        rows.append((method_label(method), [*pieces, ("r9", 100 * rest / max(f.trials, 1))]))
    most = max((sum(length for _, length in pieces) for _, pieces in rows), default=0.0)
    legend = [(f"r{i}", name.replace("_", " ")) for i, name in enumerate(shown)]
    if names[_COLORS - 1 :]:
        legend.append(("r9", "other"))
    chart = stacked_chart("reasons", rows, Axis("% of the trials", 0, 100 * _above(most / 100)))
    return _figure(
        "Why there is no map", "Share of the trials that ended without a map, by reason.", chart + _legend(legend)
    )


def _reliability_section(reliability: Mapping[str, Mapping[str, Reliability]], colors: Mapping[str, str]) -> str:
    body = [
        '<h2 id="reliability">Reliability of the stated risk</h2>'
        '<p class="soft">Some methods state a probability that their map is wrong. It is reliable if the share of '
        "false maps agrees with it. The expected number of false maps is the sum of the stated risks. Shares have "
        "95 % intervals (Wilson); a cell is coloured if its interval lies above the mean stated risk. Only maps with a "
        "sound ground truth are counted, with and without translation of the camera.</p>"
        '<p class="soft">Coverage: share of the maps of a moving camera whose pair has an error within the given '
        "number of stated standard deviations. It is 95 % or more if the deviations are right, because each of them "
        "is that of the most uncertain axis.</p>"
    ]
    for level, by_method in reliability.items():
        series = {
            colors[method]: [(100 * one.mean_risk, _percent(one.false_rate)) for one in of_method.bins if one.maps]
            for method, of_method in by_method.items()
        }
        labels = ("mean stated risk (%)", "false maps (%)")
        stated, observed = (Axis(label, *_RISK_PERCENT, log=True) for label in labels)
        title = LEVELS[level][0].upper() + LEVELS[level][1:]
        chart = _figure(
            f"Reliability diagram: {LEVELS[level]}",
            "One point for each bin of the stated risk, with the interval of its share of false maps. A share of 0 is "
            "drawn at the lower end. Dashed line: the share is equal to the stated risk. If the risk is reliable, "
            "about 19 of 20 intervals cross this line.",
            interval_chart(f"reliability diagram, {LEVELS[level]}", series, stated, observed),
        )
        legend = _legend([(colors[method], method_label(method)) for method in by_method])
        body.append(
            f"<h3>{title}</h3>{risk_table(by_method)}<h3>{title}: coverage of the stated standard deviations</h3>"
            f'{coverage_table(by_method)}{legend}<div class="charts">{chart}</div>'
        )
    return "".join(body)


def _groups_section(table: TrialTable, plan: Plan) -> str:
    return (
        '<h2 id="scenes">By scene</h2>'
        '<p class="soft">Number of trials with a correct map / a false map / no map (errors included), and the wait '
        "in frames. The picture is the first frame of a sequence of the scene.</p>"
        + group_table(table, plan.methods, thumbnails(plan.sources))
    )


def _judging_section(plan: Plan) -> str:
    return (
        '<h2 id="judging">How each sequence is judged</h2>'
        '<p class="soft">The errors are those of the worst keyframe, relative to the first keyframe. Every map is '
        "false if the camera does not translate. A sequence without ground truth is not judged.</p>"
        + judging_table(plan.judging())
    )


def _footer(plan: Plan) -> str:
    return (
        "<footer><h3>Definitions</h3><p>An accepted map is <b>correct</b> if every keyframe is within the bounds of "
        "its sequence: 5&deg; in rotation and 15&deg; in the direction of its baseline for a sound ground truth. A "
        "correct map is <b>strict</b> if every keyframe is within 1&deg; and 5&deg;. Any other map is <b>false</b>; if "
        "the camera never translates, every map is false. <b>None</b>: no map up to the limit. <b>Error</b>: the "
        "method raised, did not answer in time, crashed or used too much memory. <b>Survival</b>: share of the "
        "landmarks that are observed within 3 px of their projection after resection; median over every third of the "
        "next 30 frames. <b>ATE</b>: root mean square position error of the keyframes after alignment by a similarity, "
        "divided by the length of the true path; for maps of at least three keyframes. <b>Depth</b>: median relative "
        "error after median alignment, where depth is known.</p><p>The intervals and tests assume independent trials. "
        f"Trials of one sequence start every {plan.every} frames; they overlap and are not fully independent. The "
        "intervals of the wait resample sequences and do not need this assumption.</p></footer>"
    )


# -- parts -----------------------------------------------------------------------------------------


def _figure(title: str, note: str, content: str) -> str:
    return f"<figure><figcaption><b>{escape(title)}</b>{escape(note)}</figcaption>{content}</figure>"


def _legend(entries: Sequence[tuple[str, str]]) -> str:
    items = "".join(f'<li><i class="{name}"></i>{escape(label)}</li>' for name, label in entries)
    return f'<ul class="legend">{items}</ul>'


def _percent(share: Interval) -> Interval:
    return Interval(100 * share.value, 100 * share.low, 100 * share.high)


def _known(values: Floats) -> Floats:
    return values[np.isfinite(values)]


def _cumulative(values: Floats, total: int) -> tuple[Floats, Floats]:
    """Return the values at which a curve of shares rises, and the share at each of them."""
    xs, counts = np.unique(values, return_counts=True)
    return xs, np.cumsum(counts) / max(total, 1)


def _above(share: float) -> float:
    """Return a round upper end of an axis, at least 5 %."""
    return min(1.0, max(0.05, math.ceil(share * 22) / 20))


def method_colors(methods: Sequence[str]) -> dict[str, str]:
    """Give each method a CSS class.

    A method of the registry has the class of its place there, which does not depend on the other methods of a report.
    Two names of one method share a class, unless both are in the report. Other methods get the remaining classes in
    their order; if there are more methods than classes, classes repeat.
    """
    own = [name for name, info in METHODS.items() if info.alias_of is None]
    places = {name: position % _METHOD_COLORS for position, name in enumerate(own)}
    for name, info in METHODS.items():
        if info.alias_of is not None and info.alias_of not in methods:
            places[name] = places[info.alias_of]
    chosen = {method: places[method] for method in methods if method in places}
    free = [k for k in range(_METHOD_COLORS - 1, -1, -1) if k not in chosen.values()] or list(range(_METHOD_COLORS))
    others = (method for method in methods if method not in chosen)
    chosen |= {method: free[k % len(free)] for k, method in enumerate(others)}
    return {method: f"c{chosen[method]}" for method in methods}
