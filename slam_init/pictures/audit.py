"""``audit.png``: a map from anywhere beside the motion that explains its tracks best, in one image."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from slam_init.pictures.style import ESTIMATE, FAINT, INK, INLIER, OUTLIER, TRACK, TRUTH, canvas, png_of, wrapped, write
from slam_init.pictures.style import rgb as shown_image
from slam_init.types.arrays import Bools, Floats, Image
from slam_init.types.audit import Audit, AuditVerdict
from slam_init.types.reasons import in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH_PX, _HEIGHT_PX = 1600, 960
_COLORS = {AuditVerdict.SOUND: INLIER, AuditVerdict.DOUBTFUL: TRACK, AuditVerdict.WRONG: OUTLIER}
#: Range of the colours, as distances from an epipolar line: a third of a good tracker's noise up to an outlier.
_NEAR_PX, _FAR_PX = 0.1, 10.0
#: Smallest probability on the axis of the terms, and the bounds of the verdicts.
_LEAST, _SOUND, _WRONG = 1e-4, 0.005, 0.9
_TERMS = ("direction", "rival", "rotation", "moving", "floor", "map")
_WORDS = {
    "direction": "the best motion itself",
    "rival": "another motion is right",
    "rotation": "the camera only rotates",
    "moving": "moving bodies",
    "floor": "not modelled",
    "map": "the map's distance from it",
}
_GROUND = "#11161d"
_Box: TypeAlias = tuple[float, float, float, float]
#: The share of the points that decides the extent: a few far ones would make the rest small.
_NEAREST = 0.8


def audit_png(audit: Audit, image: Image | None = None) -> bytes:
    """Draw an audit: the matches by the map and by the best motion, the points and the cameras, and the terms.

    Parameters
    ----------
    audit : Audit
    image : (H, W) or (H, W, 3) uint8, optional
        The second frame of the audited pair, BGR; without it the matches are drawn on grey.

    Returns
    -------
    bytes
        A PNG file of 1600 x 960 pixels. Equal arguments give equal bytes with the same version of matplotlib.
    """
    matches = audit.matches
    with canvas(_WIDTH_PX, _HEIGHT_PX) as figure:
        _draw_title(figure, audit)
        colors = _draw_matches(figure, (0.02, 0.455, 0.30, 0.36), audit, matches.map_px, image, "by the map")
        _draw_matches(figure, (0.335, 0.455, 0.30, 0.36), audit, matches.best_px, image, "by the best motion")
        _draw_color_bar(figure, colors)
        _draw_points(figure.add_axes((0.715, 0.455, 0.265, 0.36)), audit)
        _draw_cameras(figure.add_axes((0.02, 0.06, 0.19, 0.30)), audit, 0, 2, 1.0, "cameras from above")
        _draw_cameras(figure.add_axes((0.225, 0.06, 0.19, 0.30)), audit, 2, 1, -1.0, "from the side")
        _draw_terms(figure.add_axes((0.60, 0.075, 0.38, 0.285)), audit)
        return png_of(figure)


def _draw_title(figure: Figure, audit: Audit) -> None:
    axes = figure.add_axes((0.02, 0.875, 0.96, 0.105))
    axes.axis("off")
    color = _COLORS[audit.verdict]
    axes.plot([0.0, 0.0], [0.0, 1.0], color=color, linewidth=10, transform=axes.transAxes, clip_on=False)
    title = f"{str(audit.verdict).capitalize()}: risk {audit.risk:.2g} that the map is wrong"
    write(axes, 0.012, 1.02, title, 25, INK, "bold")
    facts = (
        f"frames {audit.pair[0]} and {audit.pair[1]}, {len(audit.frames)} views, {audit.tracks} tracks  |  direction "
        f"{audit.direction_deg:.3g} deg from the best motion, +- {audit.direction_sigma_deg:.2g}  |  rotation "
        f"{audit.rotation_deg:.3g} deg, +- {audit.rotation_sigma_deg:.2g}"
    )
    write(axes, 0.012, 0.47, wrapped(facts, 170, 1), 12, INK)
    reason = "" if audit.reason is None else f"{in_words(audit.reason)}: "
    write(axes, 0.012, 0.16, wrapped(f"{reason}{audit.advice}", 190, 1), 10.5, FAINT)


def _draw_matches(
    figure: Figure,
    box: _Box,
    audit: Audit,
    distances_px: Floats,
    image: Image | None,
    by: str,
) -> Any:
    """The matches in the second frame of the pair, coloured by their distance from the epipolar line of a motion."""
    axes, (width, height) = figure.add_axes(box), audit.matches.size
    if image is None:
        axes.set_facecolor("#8a929c")
        axes.set_aspect("equal")
    else:
        # Pixel centres are at integers.
        axes.imshow(shown_image(image) // 2 + 64, extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    axes.set_anchor("NW")
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    _bare(axes)
    median = float(np.median(distances_px)) if len(distances_px) else 0.0
    title = f"{by}: {median:.2g} px from the epipolar lines (median of {len(distances_px)})"
    axes.set_title(title, loc="left", color=INK, fontsize=10, pad=4)
    return _scatter(axes, audit.matches.pixels2, distances_px, np.ones(len(distances_px), bool), 14)


def _draw_color_bar(figure: Figure, colors: Any) -> None:
    axes = figure.add_axes((0.645, 0.475, 0.009, 0.32))
    bar = figure.colorbar(colors, cax=axes, ticks=[0.1, 1, 10])
    bar.ax.set_yticklabels(["0.1 px", "1 px", "10 px"], fontsize=8, color=FAINT)
    bar.ax.minorticks_off()


def _draw_points(axes: Axes, audit: Audit) -> None:
    """The points of the pair by the map, from above, coloured as the matches."""
    points = audit.matches.points
    known = np.asarray(np.isfinite(points).all(axis=1))
    behind = np.count_nonzero(~known)
    axes.set_title(f"points by the map, from above ({behind} have no place)", loc="left", color=INK, fontsize=10, pad=4)
    axes.set_facecolor(_GROUND)
    _bare(axes)
    if known.any():
        far = float(np.quantile(points[known, 2], _NEAREST))
        side = float(np.quantile(np.abs(points[known, 0]), _NEAREST))
        span = max(1.1 * far, 1.1 * side, 1.2)
        box = axes.get_window_extent()
        axes.set_ylim(-0.06 * span, span)
        half = 0.5 * 1.06 * span * box.width / box.height
        axes.set_xlim(-half, half)
        _scatter(axes, points[:, ::2], audit.matches.map_px, known, 8)
    for centres, color in ((audit.matches.best_centres, TRUTH), (audit.matches.map_centres, ESTIMATE)):
        axes.plot(centres[:, 0], centres[:, 2], ".-", color=color, markersize=5, linewidth=1.2)


def _draw_cameras(axes: Axes, audit: Audit, right: int, up: int, sign: float, title: str) -> None:
    """The places of the cameras by the map and by the best motion; the pair's baseline has the length 1 in both."""
    axes.set_title(title, loc="left", color=INK, fontsize=10, pad=4)
    axes.set_facecolor(_GROUND)
    _bare(axes)
    both = np.vstack([audit.matches.map_centres, audit.matches.best_centres])[:, (right, up)] * (1.0, sign)
    middle, box = (both.min(axis=0) + both.max(axis=0)) / 2, axes.get_window_extent()
    reach = (both.max(axis=0) - both.min(axis=0)) / 2
    scale = 1.25 * max(float(reach[0]) / box.width, float(reach[1]) / box.height, 1e-9)
    axes.set_xlim(middle[0] - scale * box.width, middle[0] + scale * box.width)
    axes.set_ylim(middle[1] - scale * box.height, middle[1] + scale * box.height)
    for centres, color, style, name in (
        (audit.matches.best_centres, TRUTH, "--", "best motion"),
        (audit.matches.map_centres, ESTIMATE, "-", "map"),
    ):
        at = centres[:, (right, up)] * (1.0, sign)
        axes.plot(at[:, 0], at[:, 1], style, marker="o", color=color, markersize=4, linewidth=1.6, label=name)
    axes.plot(*(np.zeros(2)), marker="o", color="white", markersize=6)
    if right == 0:
        axes.legend(loc="upper left", bbox_to_anchor=(-0.02, -0.01), ncol=2, fontsize=9, frameon=False, borderpad=0.2)


def _draw_terms(axes: Axes, audit: Audit) -> None:
    """The terms of the risk as bars, with the bounds of the verdicts."""
    axes.set_title("the risk and its terms", loc="left", color=INK, weight="bold", pad=20)
    values = [audit.risk, *(float(getattr(audit, f"risk_{name}")) for name in _TERMS)]
    names = ["the risk", *(_WORDS[name] for name in _TERMS)]
    places = np.arange(len(values))[::-1]
    lengths = np.clip(values, _LEAST, 1.0)
    colors = [_COLORS[audit.verdict], *(len(_TERMS) * ["#9aa5b1"])]
    axes.barh(places, lengths - _LEAST, left=_LEAST, color=colors, height=0.66)
    axes.set_xscale("log")
    axes.set_xlim(_LEAST, 3.0)
    for bound, words in ((_SOUND, "sound up to 0.005"), (_WRONG, "wrong from 0.9")):
        axes.axvline(bound, color=INK, linewidth=1.0, linestyle=":")
        axes.text(bound, len(values) - 0.45, words, fontsize=8, color=FAINT, ha="center", va="bottom")
    for place, value, length in zip(places, values, lengths, strict=True):
        text = f"{value:.2g}" if value >= _LEAST else "below 0.0001"
        axes.text(length * 1.12, place, text, fontsize=9, color=INK, va="center")
    axes.set_yticks(places, names, fontsize=10)
    axes.set_xticks([1e-4, 1e-3, 1e-2, 1e-1, 1], ["0.0001", "0.001", "0.01", "0.1", "1"])
    axes.minorticks_off()
    axes.tick_params(labelsize=9, colors=FAINT)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _scatter(axes: Axes, places: Floats, distances_px: Floats, chosen: Bools, size: float) -> Any:
    """Dots whose colour is a distance; the farthest are drawn last."""
    from matplotlib.colors import LogNorm

    order = np.flatnonzero(chosen)[np.argsort(distances_px[chosen], kind="stable")]
    return axes.scatter(
        places[order, 0],
        places[order, 1],
        s=size,
        c=np.clip(distances_px[order], _NEAR_PX, _FAR_PX),
        cmap="RdYlGn_r",
        norm=LogNorm(_NEAR_PX, _FAR_PX),
        linewidths=0.3,
        edgecolors="black",
    )


def _bare(axes: Axes) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
