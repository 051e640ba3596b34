"""Colours, words and the canvas of the pictures."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from slam_init.errors import plain_line
from slam_init.types.arrays import Image
from slam_init.types.gates import Direction, Gate
from slam_init.types.reasons import Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The colours of matches and paths are those of the recording.
INLIER, OUTLIER, MOVING, TRACK = "#2fb45a", "#e64646", "#b478e6", "#ffc828"
ESTIMATE, TRUTH = "#3ca0ff", "#ff9628"
INK, PAPER, FAINT = "#1c2430", "#ffffff", "#6b7685"
#: One colour for what holds the decision: no motion blue, no scene brown, no common motion purple, flat orange, unknown
#: lens yellow, the map pink, accepted green.
VERDICT_COLORS: dict[Verdict, str] = {
    Verdict.STATIC_CAMERA: "#7d8fa3",
    Verdict.PURE_ROTATION: "#4f7cac",
    Verdict.LOW_PARALLAX: "#2aa3cf",
    Verdict.TOO_FEW_FEATURES: "#a98467",
    Verdict.TOO_FEW_MATCHES: "#7f5539",
    Verdict.NO_CONSISTENT_MOTION: "#8e44ad",
    Verdict.MOVING_BODIES: "#b478e6",
    Verdict.AMBIGUOUS_PLANE: "#f28c28",
    Verdict.UNKNOWN_FOCAL_LENGTH: "#b8a200",
    Verdict.EXTERNAL_METHOD: "#566573",
    Verdict.TOO_FEW_LANDMARKS: "#d9749f",
    Verdict.BUNDLE_ADJUSTMENT_FAILED: "#c2185b",
    Verdict.TOO_FEW_FRAMES: "#777777",
    Verdict.ACCEPTED: INLIER,
}
DOTS_PER_INCH = 100


@contextmanager
def canvas(width_px: int, height_px: int) -> Iterator[Figure]:
    """Make an empty figure, with matplotlib's own defaults instead of those of the user.

    * Returns: With a canvas that needs no display. It has to be drawn in the ``with`` block.
    """
    import logging
    import warnings

    # Without a home folder matplotlib logs where its cache is, and each letter that its fonts do not have.
    log = logging.getLogger("matplotlib")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        import matplotlib
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        with matplotlib.rc_context(), warnings.catch_warnings():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update({"font.family": ["DejaVu Sans"], "axes.titlesize": 10, "font.size": 10})
            # A name may have letters that the font lacks: they are drawn as boxes.
            warnings.filterwarnings("ignore", message=".*[Gg]lyph.*")
            figure = Figure(figsize=(width_px / DOTS_PER_INCH, height_px / DOTS_PER_INCH), dpi=DOTS_PER_INCH)
            FigureCanvasAgg(figure)
            figure.set_facecolor(PAPER)
            yield figure
    finally:
        log.setLevel(level)


def png_of(figure: Figure) -> bytes:
    """Draw a figure and compress it.

    * Returns: A PNG file without any metadata, so that equal pictures are equal bytes.
    """
    import cv2

    bgr = np.ascontiguousarray(pixels_of(figure)[..., ::-1])
    # Other strategies take half as long again, and the file is hardly smaller: images have noise.
    _, encoded = cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE])
    return encoded.tobytes()


def pixels_of(figure: Figure) -> Image:
    """Draw a figure: returns (H, W, 3)."""
    from io import BytesIO

    raw = BytesIO()
    figure.savefig(raw, format="rgba", dpi="figure")
    height = round(figure.get_figheight() * figure.dpi)
    return np.frombuffer(raw.getvalue(), np.uint8).reshape(height, -1, 4)[..., :3]


def write(axes: Axes, x: float, y: float, text: str, size: float, color: str = INK, weight: str = "normal") -> None:
    """Write a text at the left top of a place in axes that are otherwise empty."""
    axes.text(
        x,
        y,
        text,
        transform=axes.transAxes,
        fontsize=size,
        color=color,
        weight=weight,
        va="top",
        ha="left",
        parse_math=False,
    )


def wrapped(text: str, columns: int, most_lines: int = 4) -> str:
    """Break a text of one line into several."""
    return "\n".join(textwrap.wrap(plain_line(text), columns, max_lines=most_lines, placeholder=" ..."))


def gate_words(gate: Gate) -> str:
    """Write what a gate compares."""
    unit = f" {gate.unit}" if gate.unit else ""
    name = str(gate.name).removesuffix(f"_{gate.unit}").replace("_", " ")
    side = "at least" if gate.direction is Direction.AT_LEAST else "at most"
    return f"{name} {gate.value:.3g}{unit}, needs {side} {gate.threshold:.3g}{unit}"


def rgb(image: Image) -> Image:
    """Return an image as matplotlib shows it: ``image`` (H, W), returns (H, W, 3)."""
    if image.ndim == 2:
        return np.repeat(image[..., None], 3, axis=2)
    return np.ascontiguousarray(image[..., ::-1])
