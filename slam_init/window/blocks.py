"""The compiled loops that gather the observations of blocks of tracks, in rows (:mod:`slam_init.window.rows`)."""

from __future__ import annotations

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window import rows as at
from slam_init.window.compiler import compiled
from slam_init.window.rows import LANES


@compiled
def list_blocks(anchor: Ints, views: int, tracks: Ints, anchors: Ints, counts: Ints) -> int:
    """List the tracks that take part in blocks with one anchor view each.

    Shapes: ``anchor`` (T,), ``tracks`` (B, LANES), ``anchors, counts`` (B,) of :class:`Observed`, with room for more.

    * Returns: The number of blocks.
    """
    blocks = 0
    for a in range(views):
        count = LANES
        for i in range(len(anchor)):
            if anchor[i] != a:
                continue
            if count == LANES:
                anchors[blocks] = a
                for lane in range(LANES):
                    tracks[blocks, lane] = i
                blocks, count = blocks + 1, 0
            tracks[blocks - 1, count] = i
            count += 1
            counts[blocks - 1] = count
    return blocks


@compiled
def gather(
    pixels: Floats,
    sigma_px: Floats,
    whitening: Floats,
    sweep_px_s: Floats,
    places: Floats,
    seen: Bools,
    tracks: Ints,
    counts: Ints,
    has_fields: bool,
    out: Floats,
) -> None:
    """Gather the observations of blocks of tracks.

    Shapes: those of :class:`slam_init.window.tracks.WindowTracks` and of :class:`slam_init.window.arguments.Observed`.
    """
    for b in range(len(tracks)):
        for k in range(len(seen)):
            n = b * len(seen) + k
            for lane in range(LANES):
                i = tracks[b, lane]
                inverse = 1.0 / sigma_px[k, i]
                out[n, at.SEEN + lane] = 1.0 if lane < counts[b] and seen[k, i] else 0.0
                out[n, at.PIXEL[0] + lane], out[n, at.PIXEL[1] + lane] = pixels[k, i, 0], pixels[k, i, 1]
                out[n, at.SWEEP[0] + lane], out[n, at.SWEEP[1] + lane] = sweep_px_s[k, i, 0], sweep_px_s[k, i, 1]
                out[n, at.WHITEN[0] + lane] = whitening[k, i, 0, 0] * inverse
                out[n, at.WHITEN[1] + lane] = whitening[k, i, 0, 1] * inverse
                out[n, at.WHITEN[2] + lane] = whitening[k, i, 1, 1] * inverse
                for q in range(6 if has_fields else 0):
                    out[n, at.PLACES[q] + lane] = places[k, i, q] * sigma_px[k, i]
