"""The hypotheses that live across frames: pairs propose them, each frame joins their fit, beaten ones are dropped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from quest.estimate import RelativePose
from slam_init.system.linear_algebra import single_threaded
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.inertial import RelativeRotation
from slam_init.types.lens import CurrentLens
from slam_init.window.hypotheses import WindowHypotheses, fit_hypotheses, motions_at_focal, motions_of_pair, with_plane
from slam_init.window.levels import LARGEST_VOTE
from slam_init.window.motion import Motion, fit_motion
from slam_init.window.state import Priors
from slam_init.window.tracks import gather_tracks

#: Number of motions that are carried from frame to frame: both motions of a plane, and two that other pairs found.
#: Class: budget.
_MAX_MOTIONS = 4
#: A motion against which the tracks vote by this is dropped: a hundred nats. More frames hardly turn that.
#: Class: level, in twice the nats.
_HOPELESS = 200.0


class LiveHypotheses:
    """The motions of the window, from frame to frame.

    * ``least_noise_px``: Lower limit of the noise of a track.
    """

    def __init__(self, least_noise_px: float = 0.1) -> None:
        self._least_noise_px = least_noise_px
        self._motions: list[Motion] = []
        self._proposed: list[Motion] = []
        self._rotations: tuple[Motion, ...] = ()
        self._noise_px = 0.0

    def __bool__(self) -> bool:
        return bool(self._motions or self._proposed)

    def propose(
        self,
        pose: RelativePose,
        frames: tuple[int, int],
        rays1: Floats,
        rays2: Floats,
        noise_px: float,
        readout_s: float = 0.0,
    ) -> None:
        """Add the motions of a pair.

        Shapes: ``frames`` (int, int), ``rays1, rays2`` (N, 3).
        """
        self._proposed = motions_of_pair(pose, frames, rays1, rays2, readout_s)
        self._noise_px = self._noise_px or noise_px

    @property
    def frames(self) -> frozenset[int]:
        """The frames whose poses the best motion knows."""
        return frozenset(self._motions[0].cam_from_world) if self._motions else frozenset()

    def change_lens(self, old: CurrentLens, new: CurrentLens) -> None:
        """Go on with another lens: the motions were fitted through the old one."""
        if new is old:
            return
        log_scale, k1 = new.log_scale - old.log_scale, new.k1 - old.k1

        def through_new(motion: Motion) -> Motion:
            lens = motion.lens
            return replace(motion, lens=lens._replace(log_scale=lens.log_scale - log_scale, k1=lens.k1 - k1))

        self._motions = [through_new(one) for one in self._motions]
        self._rotations = tuple(through_new(one) for one in self._rotations)

    def forget(self) -> None:
        """Drop all motions."""
        self._motions, self._proposed, self._rotations = [], [], ()

    def fitted(
        self,
        camera: Camera,
        priors: Priors,
        views: Sequence[Observations],
        measured: Sequence[RelativeRotation | None] = (),
    ) -> WindowHypotheses | None:
        """Fit all motions to the views of a window, and keep those that are not hopeless."""
        with single_threaded():
            tracks = gather_tracks(camera, views, self._noise_px, self._least_noise_px, measured=measured)
            # Where no turning is known, the readout moves no pixel.
            priors = priors if tracks.sweep_px_s.any() else replace(priors, readout_sigma_s=0.0)
            hypotheses = fit_hypotheses(tracks, [*self._motions, *self._proposed], priors, self._rotations)
        if hypotheses is None:
            self.forget()
            return None
        self._noise_px = hypotheses.tracks.noise_px
        gain, freedom = hypotheses.gain_over_rotation
        # Twice the gain is as large as this by chance alone: there is nothing to carry on.
        if 2 * gain < freedom:
            self._motions, self._proposed, self._rotations = [], [], hypotheses.rotations
            return hypotheses
        self.keep(hypotheses)
        self._proposed = []
        return hypotheses

    def with_better_motion(self, hypotheses: WindowHypotheses) -> WindowHypotheses | None:
        """The hypotheses with the motions of the pair at the noise of the window, where one explains the tracks better.

        A pair proposes its motions at its own noise, before further views are known. On film of poor quality all of
        them may lead to a local optimum.
        """
        tracks, best = hypotheses.tracks, hypotheses.motions[0]
        with single_threaded():
            motions = [one for one in motions_at_focal(hypotheses, 0.0) if not one.is_near(best.motion)]
            if hypotheses.planar:
                motions = [with_plane(one, tracks, hypotheses.bearings) for one in motions]
            fits = [fit_motion(tracks, one, hypotheses.priors) for one in motions]
            # By more than one track may vote: less is chance, or another end of the same optimum.
            better = [
                one.motion for one in fits
                if len(one.rows) == len(best.rows) and one.fit.cost < best.fit.cost - LARGEST_VOTE
            ]  # fmt: skip
            if not better:
                return None
            motions = [*better, *(one.motion for one in hypotheses.motions)]
            again = fit_hypotheses(tracks, motions, hypotheses.priors, hypotheses.rotations)
        if again is None:
            return None
        return replace(again, other_before=hypotheses.other_before, overlay=hypotheses.overlay)

    def keep(self, hypotheses: WindowHypotheses) -> None:
        """Go on with the motions of hypotheses, but for those that the tracks vote against."""
        best = hypotheses.motions[0]
        # By their votes, not by their costs: a few tracks on a moving object cost as much as they are far off.
        kept = [
            m for m in hypotheses.motions
            if len(m.rows) < len(best.rows) or hypotheses.votes(best, m).sum() < _HOPELESS
        ]  # fmt: skip
        self._motions = [replace(fitted.motion, is_new=False) for fitted in kept[:_MAX_MOTIONS]]
        self._rotations = hypotheses.rotations
