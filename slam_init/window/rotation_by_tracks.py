"""A camera that only rotates, located by some of the tracks of a window, and what it costs the others."""

from __future__ import annotations

import math

import numpy as np

from slam_init.types.arrays import Floats, Ints
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.joint_fit import MAX_STEPS, JointFit, fit_window
from slam_init.window.locating import align_views
from slam_init.window.state import WindowState, start_at
from slam_init.window.tracks import WindowTracks


def rotation_of(
    hypotheses: WindowHypotheses,
    chosen: Ints,
    lens: WindowState,
    *,
    max_steps: int = MAX_STEPS,
    hopeless: float = math.inf,
) -> JointFit:
    """A camera that only rotates, which some tracks alone locate.

    * ``lens``: A state with the lens to start from.
    """
    tracks = hypotheses.tracks.of_tracks(chosen)
    bearings = tracks.bearings(lens.log_scale, lens.readout_s, lens.k1, lens.principal_px)
    bearings[~tracks.seen] = np.nan
    R = align_views(bearings, [hypotheses.motions[0].motion], tracks.frames[:2])
    start = _started(tracks, R, hypotheses.rotation_only.state.t, lens)
    return fit_window(
        tracks, start, hypotheses.rotation_priors, rotation_only=True, max_steps=max_steps, hopeless=hopeless
    )


def costs_of_rotation(hypotheses: WindowHypotheses, chosen: Ints, fit: JointFit) -> Floats:
    """The costs of some tracks in a camera that only rotates, as others have located it."""
    tracks = hypotheses.tracks.of_tracks(chosen)
    start = _started(tracks, fit.state.R, fit.state.t, fit.state)
    return fit_window(tracks, start, hypotheses.rotation_priors, rotation_only=True, max_steps=0).track_costs


def _started(tracks: WindowTracks, R: Floats, t: Floats, lens: WindowState) -> WindowState:
    return start_at(
        tracks, R, t, log_scale=lens.log_scale, k1=lens.k1, readout_s=lens.readout_s,
        principal_px=lens.principal_px, at_infinity=True,
    )  # fmt: skip
