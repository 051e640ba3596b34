"""A camera that only rotates, located by some of the tracks of a window, and what it costs the others."""

from __future__ import annotations

import math

from slam_init.types.arrays import Floats, Ints
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.joint_fit import MAX_STEPS, JointFit, fit_window
from slam_init.window.lens_offset import LensOffset
from slam_init.window.locating import align_views
from slam_init.window.state import start_at


def rotation_of(
    hypotheses: WindowHypotheses,
    chosen: Ints,
    lens: LensOffset,
    *,
    max_steps: int = MAX_STEPS,
    hopeless: float = math.inf,
) -> JointFit:
    """A camera that only rotates, which some tracks alone locate.

    * ``lens``: Where the fit starts.
    """
    tracks = hypotheses.tracks.of_tracks(chosen)
    R = align_views(tracks.bearings(lens), [hypotheses.motions[0].motion], tracks.frames[:2])
    start = start_at(tracks, R, hypotheses.rotation_only.state.t, lens=lens, at_infinity=True)
    return fit_window(
        tracks, start, hypotheses.rotation_priors, rotation_only=True, max_steps=max_steps, hopeless=hopeless
    )


def costs_of_rotation(hypotheses: WindowHypotheses, chosen: Ints, fit: JointFit) -> Floats:
    """The costs of some tracks in a camera that only rotates, as others have located it."""
    tracks = hypotheses.tracks.of_tracks(chosen)
    start = start_at(tracks, fit.state.R, fit.state.t, lens=fit.state.lens, at_infinity=True)
    return fit_window(tracks, start, hypotheses.rotation_priors, rotation_only=True, max_steps=0).track_costs
