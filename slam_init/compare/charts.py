"""Charts as inline SVG: curves, boxes, bars, points with intervals.

Colours are CSS classes of the page, so that the charts follow its light and its dark theme, which pictures of
matplotlib cannot. The charts are 460 units wide, and letters are 12 units high. A phone shows these letters at 9
pixels, and a column on a desktop at 15 pixels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from slam_init.compare.statistics import Interval
from slam_init.types.arrays import Floats

_WIDTH, _HEIGHT = 460.0, 260.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 12.0, 10.0, 38.0
#: Width and height of the area between two axes.
_PLOT_WIDTH, _PLOT = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
#: For charts with one row per method: width of the column of names, height of a row.
_NAMES, _ROW = 112.0, 24.0
_ROW_WIDTH = _WIDTH - _NAMES - _RIGHT
_MAX_TICKS = 6


@dataclass(frozen=True)
class Axis:
    """A horizontal or vertical axis."""

    label: str
    #: low, high: Values at the left (or lower) end and at the right (or upper) end.
    low: float
    high: float
    #: Logarithmic scale.
    log: bool = False

    def at(self, value: float) -> float:
        """Position of a value on the axis."""
        clipped = min(max(value, self.low), self.high)
        if self.log:
            return math.log(clipped / self.low) / math.log(self.high / self.low)
        return (clipped - self.low) / (self.high - self.low)

    def ticks(self) -> list[float]:
        """Choose the ticks of the axis.

        * Returns: Round values within the range; powers of ten on a logarithmic scale.
        """
        if self.log:
            first, last = math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9)
            return [10.0**k for k in range(first, last + 1)]
        span = self.high - self.low
        step = 10.0 ** math.floor(math.log10(span / _MAX_TICKS))
        step *= next(factor for factor in (1, 2, 5, 10) if span / (step * factor) <= _MAX_TICKS)
        first = math.ceil(self.low / step - 1e-9)
        return [k * step for k in range(first, math.floor(self.high / step + 1e-9) + 1)]


def curve_chart(
    title: str, curves: Mapping[str, tuple[Floats, Floats]], x: Axis, y: Axis, marks: Sequence[float]
) -> str:
    """Draw step curves.

    * ``curves``: CSS class to the points x, y of the curve. Each value of y holds from its x to the next x.
    """
    parts = _axes(x, y)
    for mark in marks:
        column, _ = _place(x, y, mark, y.low)
        parts.append(f'<line class="mark" x1="{column:.1f}" x2="{column:.1f}" y1="{_TOP:g}" y2="{_TOP + _PLOT:g}"/>')
    for name, (xs, ys) in reversed(list(curves.items())):  # the first is drawn last, on top
        if len(xs) == 0:
            continue
        path, before = [], y.low
        for a, b in zip(xs.tolist(), ys.tolist(), strict=True):
            (column, start), (_, row) = _place(x, y, a, before), _place(x, y, a, b)
            path.append(f"{column:.1f},{start:.1f} {column:.1f},{row:.1f}")
            before = b
        end, row = _place(x, y, x.high, before)
        path.append(f"{end:.1f},{row:.1f}")
        parts.append(f'<polyline class="curve {name}" points="{" ".join(path)}"/>')
    return _svg(title, _HEIGHT, parts)


def interval_chart(title: str, series: Mapping[str, Sequence[tuple[float, Interval]]], x: Axis, y: Axis) -> str:
    """Draw points with their intervals, and a dashed line on which both axes have the same value.

    * ``series``: CSS class to the points: x, and y with its interval. Values outside an axis are drawn at its nearer
      end.
    """
    (x1, y1), (x2, y2) = (_place(x, y, end, end) for end in (max(x.low, y.low), min(x.high, y.high)))
    parts = [*_axes(x, y), f'<line class="mark" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>']
    for name, points in reversed(list(series.items())):  # the first is drawn last, on top
        for a, share in points:
            (column, row), (_, low), (_, high) = (_place(x, y, a, value) for value in share)
            parts.append(
                f'<line class="whisker {name}" x1="{column:.1f}" x2="{column:.1f}" y1="{low:.1f}" y2="{high:.1f}"/>'
                f'<circle class="{name}" cx="{column:.1f}" cy="{row:.1f}" r="4"/>'
            )
    return _svg(title, _HEIGHT, parts)


def box_chart(title: str, rows: Sequence[tuple[str, str, Floats]], x: Axis) -> str:
    """Draw quartiles, median, and whiskers to the 5th and 95th percentile for each row: label, CSS class, values."""
    parts = [_horizontal_axis(x, _NAMES, _ROW_WIDTH, _ROW * len(rows))]
    for i, (label, name, values) in enumerate(rows):
        middle = _TOP + _ROW * (i + 0.5)
        parts.append(_row_label(label, middle))
        if len(values) == 0:
            parts.append(f'<text class="faint" x="{_NAMES + 6:g}" y="{middle + 4:.1f}">none</text>')
            continue
        low, first, median, third, high = (
            _NAMES + _ROW_WIDTH * x.at(float(q)) for q in np.quantile(values, [0.05, 0.25, 0.5, 0.75, 0.95])
        )
        parts += [
            f'<line class="whisker {name}" x1="{low:.1f}" x2="{high:.1f}" y1="{middle:.1f}" y2="{middle:.1f}"/>',
            f'<rect class="box {name}" x="{first:.1f}" y="{middle - 7:.1f}" width="{max(third - first, 1):.1f}" '
            f'height="14" rx="2"/>',
            f'<line class="median {name}" x1="{median:.1f}" x2="{median:.1f}" y1="{middle - 7:.1f}" '
            f'y2="{middle + 7:.1f}"/>',
        ]
    return _svg(title, _TOP + _ROW * len(rows) + _BOTTOM, parts)


def stacked_chart(title: str, rows: Sequence[tuple[str, Sequence[tuple[str, float]]]], x: Axis) -> str:
    """Draw a stacked bar for each row: label, and CSS class and length of each piece in units of the axis."""
    parts = [_horizontal_axis(x, _NAMES, _ROW_WIDTH, _ROW * len(rows))]
    for i, (label, pieces) in enumerate(rows):
        middle, done = _TOP + _ROW * (i + 0.5), 0.0
        parts.append(_row_label(label, middle))
        for name, length in pieces:
            begin, end = (_NAMES + _ROW_WIDTH * x.at(value) for value in (done, done + length))
            parts.append(
                f'<rect class="piece {name}" x="{begin:.1f}" y="{middle - 8:.1f}" width="{max(end - begin, 0):.1f}" '
                f'height="16"/>'
            )
            done += length
    return _svg(title, _TOP + _ROW * len(rows) + _BOTTOM, parts)


def _place(x: Axis, y: Axis, a: float, b: float) -> tuple[float, float]:
    """Column and row of a point of a chart with two axes."""
    return _LEFT + _PLOT_WIDTH * x.at(a), _TOP + _PLOT * (1 - y.at(b))


def _row_label(label: str, middle: float) -> str:
    return f'<text class="end" x="{_NAMES - 8:g}" y="{middle + 4:.1f}">{escape(label)}</text>'


def _axes(x: Axis, y: Axis) -> list[str]:
    parts = [_horizontal_axis(x, _LEFT, _PLOT_WIDTH, _PLOT)]
    for tick in y.ticks():
        row = _TOP + _PLOT * (1 - y.at(tick))
        parts.append(
            f'<line class="grid" x1="{_LEFT:g}" x2="{_LEFT + _PLOT_WIDTH:g}" y1="{row:.1f}" y2="{row:.1f}"/>'
            f'<text class="end" x="{_LEFT - 6:g}" y="{row + 4:.1f}">{_number(tick)}</text>'
        )
    middle = f"translate(11 {_TOP + _PLOT / 2:g}) rotate(-90)"
    return [*parts, f'<text class="rotated" transform="{middle}">{escape(y.label)}</text>']


def _horizontal_axis(x: Axis, left: float, width: float, height: float) -> str:
    parts = []
    for tick in x.ticks():
        column = left + width * x.at(tick)
        parts.append(
            f'<line class="grid" x1="{column:.1f}" x2="{column:.1f}" y1="{_TOP:g}" y2="{_TOP + height:g}"/>'
            f'<text class="middle" x="{column:.1f}" y="{_TOP + height + 15:g}">{_number(tick)}</text>'
        )
    parts.append(f'<text class="middle" x="{left + width / 2:g}" y="{_TOP + height + 32:g}">{escape(x.label)}</text>')
    return "".join(parts)


def _svg(title: str, height: float, parts: Sequence[str]) -> str:
    return (
        f'<svg viewBox="0 0 {_WIDTH:g} {height:g}" role="img" aria-label="{escape(title)}">'
        f"<title>{escape(title)}</title>{''.join(parts)}</svg>"
    )


def _number(value: float) -> str:
    return f"{value:g}" if abs(value) < 1e4 else f"{value:.0e}"
