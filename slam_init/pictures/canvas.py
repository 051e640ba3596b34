"""The ground of a picture: colours, fonts, and where its parts and texts stand."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from slam_init.errors import plain_line
from slam_init.types.arrays import Image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The colours of matches and paths are those of the recording.
INLIER, OUTLIER, MOVING, TRACK = "#2fb45a", "#e64646", "#b478e6", "#ffc828"
ESTIMATE, TRUTH = "#3ca0ff", "#ff9628"
INK, PAPER, FAINT, GROUND = "#1c2430", "#ffffff", "#6b7685", "#11161d"
#: Of matplotlib: texts in a font that it brings, and legends without a frame.
_STYLE: dict[Any, Any] = {
    "font.family": ["DejaVu Sans"],
    "font.size": 10,
    "axes.titlesize": 10,
    "legend.frameon": False,
    "legend.borderpad": 0.1,
    "legend.fontsize": 8,
    "legend.title_fontsize": 8,
}


@contextmanager
def canvas(width_px: int, height_px: int) -> Iterator[Figure]:
    """Make an empty figure, with matplotlib's own defaults instead of those of the user.

    * Returns: It has to be used in the ``with`` block.
    """
    import logging
    import warnings

    # Without a home folder matplotlib logs where its cache is, and each letter that its fonts do not have.
    log = logging.getLogger("matplotlib")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        import matplotlib
        from matplotlib.figure import Figure

        with matplotlib.rc_context(), warnings.catch_warnings():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(_STYLE)
            # A name may have letters that the font lacks: they are shown as boxes.
            warnings.filterwarnings("ignore", message=".*[Gg]lyph.*")
            yield Figure(figsize=(width_px / 100, height_px / 100), dpi=100, facecolor=PAPER)
    finally:
        log.setLevel(level)


def pixels_of(figure: Figure) -> Image:
    """Draw a figure: returns (H, W, 3)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    agg: Any = FigureCanvasAgg(figure)  # its stubs lack the drawing
    agg.draw()
    return np.asarray(agg.buffer_rgba())[..., :3]


def axes_at(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Add axes at a place in pixels from the left top of a figure."""
    size = figure.get_size_inches() * figure.dpi
    return figure.add_axes((left / size[0], 1 - (top + height) / size[1], width / size[0], height / size[1]))


def blank(axes: Axes) -> Axes:
    """Let axes hold text alone."""
    axes.axis("off")
    return axes


def write(axes: Axes, x: float, y: float, text: str, size: float, color: str = INK, weight: str = "normal") -> None:
    """Write a text at the left top of a place in axes that are otherwise empty."""
    place = axes.transAxes
    axes.text(x, y, text, transform=place, fontsize=size, color=color, weight=weight, va="top", parse_math=False)


def wrapped(text: str, columns: int, most_lines: int = 4) -> str:
    """Break a text of one line into several."""
    return "\n".join(textwrap.wrap(plain_line(text), columns, max_lines=most_lines, placeholder=" ..."))
