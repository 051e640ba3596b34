"""The pipeline, to be read from top to bottom.

A frame arrives; its tracks are followed; the keyframe manager offers pairs with earlier frames; the best pair is tried:
two-view geometry through QuEst, a map for each hypothesis, the vote of further views, bundle adjustment, gates. The
first map that passes all of them ends the initialization. What is refused is refused for a reason, with its evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from quest.estimate import Hypothesis, NoPose, RelativePose, estimate_relative_pose
from slam_init import acceptance
from slam_init.bundle import BundleSolution
from slam_init.calibration_check import turning_camera
from slam_init.camera import Camera
from slam_init.config import Config, config_toml
from slam_init.continuation import follow
from slam_init.export import RECORDING, prepare_folder, summary_dict, write_results
from slam_init.handover import (
    Evidence,
    initial_map,
    prevailing_reason,
    preview_evidence,
    refusal,
    refused,
    without_matches,
)
from slam_init.keyframes import KeyframeManager, PairPreview, difference_gate
from slam_init.mapping import (
    MapCandidate,
    Margin,
    build_candidate,
    further_views,
    margin,
    rank,
    same_map,
    table_of,
    voting_views,
)
from slam_init.methods import make_initializer
from slam_init.metrics import compare_with_groundtruth
from slam_init.plane_vote import plane_margin
from slam_init.reasons import ACCEPTED
from slam_init.recording import Recorder, RerunRecorder
from slam_init.timing import Stopwatch
from slam_init.tracks import Tracker, common_tracks
from slam_init.types import Attempt, Frame, InitialMap, Observations, Result, Source

__all__ = ["Initializer", "run"]

#: A tenth of the tracks may be mistaken; more of them displaced against the rotation is a motion to look at.
_LEAST_PARALLAX_SHARE = 0.1
#: What a later attempt may find that speaks against an earlier pair which no third view confirmed.
_AGAINST_TWO_VIEWS = ("pure_rotation", "no_consistent_motion", "ambiguous_plane", "bundle_adjustment_failed")


def run(
    source: Source,
    camera: Camera,
    config: Config,
    *,
    out: Path | None = None,
    start: int = 0,
    max_frames: int | None = None,
    continue_frames: int = 0,
    progress: bool = False,
    notes: tuple[str, ...] = (),
) -> tuple[Result, dict[str, Any]]:
    """Initialize from a source and write what came of it.

    Parameters
    ----------
    source : Source
    camera : Camera
    config : Config
    out : Path, optional
        Folder of the results (see :mod:`slam_init.export`) and of the recording; nothing is written without.
    start, max_frames : int
        First frame (absolute index), and how many at most.
    continue_frames : int
        After the initialization, locate this many further frames in the map.
    progress : bool
        Show a progress bar on stderr.
    notes : tuple of str
        What the user should be reminded of, for the summary.

    Returns
    -------
    result : Result
    summary : dict
        The content of ``summary.json``.

    Raises
    ------
    SlamInitError
        Where a frame cannot be read or a result cannot be written.
    """
    if out is not None:
        prepare_folder(out)
    recorder = (
        Recorder()
        if out is None
        else RerunRecorder(out / RECORDING, camera, source.name, source.groundtruth, config.seed)
    )
    with recorder:
        initializer = make_initializer(config.method, camera, config, recorder)
        frames = source.frames(start=start, max_frames=None if continue_frames else max_frames)
        for frame in _with_progress(frames, min(len(source) - start, max_frames or len(source)), progress):
            initializer.process(frame)
            if initializer.map is not None or initializer.frames_read == max_frames:
                break
        result = replace(initializer.finish(), notes=notes)
        continued = None
        if result.map is not None and continue_frames:
            continued = follow(result.map, initializer.tracker, camera, frames, continue_frames, recorder)
            if continued.ended_by is not None:
                result = replace(result, notes=(*result.notes, f"the continuation ended early: {continued.ended_by}"))
        truth = None
        if result.map is not None and source.groundtruth is not None:
            truth = compare_with_groundtruth(result.map.keyframes, source.groundtruth)
        summary = summary_dict(
            result,
            source,
            camera,
            config.method,
            config.seed,
            truth,
            continued.summary() if continued else None,
        )
        recorder.summary(summary)
    if out is not None:
        poses = continued.keyframes if continued else ()
        write_results(out, result, summary, camera, config_toml(config), poses)
    return result, summary


def _with_progress(frames: Iterator[Frame], total: int, show: bool) -> Iterator[Frame]:
    from tqdm import tqdm

    with tqdm(total=total, unit="frame", desc="waiting for parallax", disable=not show, leave=False) as bar:
        for frame in frames:
            yield frame
            bar.update()


@dataclass(frozen=True, eq=False)
class _Acceptance:
    """A map that passed the gates, its scene (``general`` or ``planar``), and the frames that it is made of."""

    bundle: BundleSolution
    scene: str
    views: tuple[Observations, ...]


class Initializer:
    """Feed it frames until it has a map: images by :meth:`process`, or tracks of your own by :meth:`process_tracks`.

    Parameters
    ----------
    camera : Camera
    config : Config, optional
    recorder : Recorder, optional
        Is told of every frame, attempt and map.
    third_view : bool
        Whether further views decide between two motions and confirm the map. Without them the better two-view map is
        taken where the gates that two views allow are passed: the method ``quest-two-view``.

    Attributes
    ----------
    map : InitialMap or None
        Set when a map was accepted.
    frames_read : int
    tracker : Tracker
    history : History
        What was seen in the last frames; :attr:`tracker` adds to the same one.
    """

    def __init__(
        self,
        camera: Camera,
        config: Config | None = None,
        recorder: Recorder | None = None,
        *,
        third_view: bool = True,
    ) -> None:
        self.camera = camera
        self.config = config or Config()
        self.recorder = recorder or Recorder()
        self.tracker = Tracker(camera, self.config.tracking)
        self.history = self.tracker.history
        self.keyframes = KeyframeManager(camera, self.config)
        self.stopwatch = Stopwatch()
        self.map: InitialMap | None = None
        self.frames_read = 0
        self._third_view = third_view
        self._attempts: list[Attempt] = []
        self._accepted: _Acceptance | None = None
        self._two_views_only: tuple[Attempt, _Acceptance] | None = None

    def process(self, frame: Frame) -> Attempt | None:
        """Take in the next frame; return the attempt that it led to, if any. After an accepted one ``map`` is set."""
        with self.stopwatch("track"):
            current = self.tracker.track(frame)
        self.recorder.frame(frame, current)
        return self.process_tracks(current)

    def process_tracks(self, current: Observations, revised: Sequence[Observations] = ()) -> Attempt | None:
        """Take in the tracks of the next frame, found elsewhere: a cache, or features and matches of your own.

        Feed either images or tracks: the tracker knows nothing of track ids that it did not give.

        Parameters
        ----------
        current : Observations
            One feature of the world has one track id in all frames. Frames come in ascending order.
        revised : sequence of Observations, optional
            Earlier frames of which more is known by now (see :attr:`slam_init.tracks.Tracker.revised`); those that
            were not fed, or are forgotten, are passed over.

        Returns
        -------
        Attempt or None
            As :meth:`process`.

        Raises
        ------
        SlamInitError
            Where the arrays do not belong together, a bearing is not finite, or the frame is not the next one.
        """
        self.history.take(current, revised)
        self.frames_read += 1
        with self.stopwatch("pairs"):
            pairs = self.keyframes.preview(self.history, current)
            chosen = self.keyframes.worth_trying(pairs)
        attempt = self._screen(current, pairs)
        if attempt is None and chosen is not None:
            attempt = self._try(chosen, current)
            if attempt.verdict in _AGAINST_TWO_VIEWS:
                self._two_views_only = None
            if attempt.verdict != ACCEPTED:
                self.keyframes.failed(chosen, float(attempt.evidence.get("lacking", 1.0)))
        if attempt is not None:
            self._remember(attempt)
            if self._accepted is not None:
                self._hand_over(self._accepted)
        self.keyframes.update(current, pairs)
        self.history.forget(keep=self.keyframes.candidates)
        return attempt

    def finish(self) -> Result:
        """No more frames: the map, or the reason why there is none."""
        if self.map is None and self._two_views_only is not None:
            # The sequence has no third view for a pair that two views decide beyond doubt.
            attempt, accepted = self._two_views_only
            self._remember(replace(attempt, verdict=ACCEPTED, advice=""))
            self._hand_over(accepted)
        return Result(
            map=self.map,
            reason=None if self.map is not None else prevailing_reason(self._attempts),
            frames_read=self.frames_read,
            frames_to_init=self.frames_read if self.map is not None else None,
            attempts=tuple(self._attempts),
            timing_ms=self.stopwatch.summary(),
        )

    # -- one frame --------------------------------------------------------------------------------

    def _screen(self, current: Observations, pairs: list[PairPreview]) -> Attempt | None:
        """Refuse at a glance what no pair can yield: no tracks, no motion, no parallax."""
        if not pairs:
            return None
        needed = self.config.keyframes.min_matches
        usable = [pair for pair in pairs if pair.matches >= needed]
        pair = (usable or pairs)[0]
        evidence = preview_evidence(pair)
        frames = (pair.reference, pair.current)
        if len(current) < needed:
            return refusal(frames, "too_few_features", evidence | {"features": len(current), "features_needed": needed})
        if not usable:
            return refusal(frames, "too_few_matches", evidence | {"matches_needed": needed})
        noise_gate_px = difference_gate(self.config.map.noise_px)
        if max(p.motion_px for p in usable) < noise_gate_px:
            return refusal(frames, "static_camera", evidence | {"motion_gate_px": noise_gate_px})
        if max(p.parallax_share for p in usable) < _LEAST_PARALLAX_SHARE:
            evidence |= {"parallax_share_needed": _LEAST_PARALLAX_SHARE}
            return refusal(frames, "pure_rotation", evidence)
        return None

    def _try(self, pair: PairPreview, current: Observations) -> Attempt:
        """Two-view geometry, a map for each hypothesis, the vote, the gates."""
        reference = self.history[pair.reference]
        i, j = common_tracks(reference, current)
        m, n = reference.bearings[i], current.bearings[j]
        threshold_rad = self.config.two_view.threshold_px / self.camera.focal_px
        with self.stopwatch("two_view"):
            pose = estimate_relative_pose(m, n, threshold_rad=threshold_rad, seed=self.config.seed)
        attempt = Attempt(
            frames=(pair.reference, pair.current),
            verdict=ACCEPTED,
            evidence=preview_evidence(pair) | _pose_evidence(pose, self.camera),
            pixels1=reference.pixels[i],
            pixels2=current.pixels[j],
            inliers=pose.inliers if isinstance(pose, RelativePose) else np.zeros(len(i), bool),
        )
        verdict, evidence = self._two_view_verdict(attempt, pose)
        if verdict != ACCEPTED or not isinstance(pose, RelativePose):
            return refused(attempt, verdict, evidence)
        with self.stopwatch("map"):
            views = further_views(self.history, reference, current, self.config.map) if self._third_view else []
            table = table_of(reference, current, views)
            hypotheses: list[Hypothesis | RelativePose] = [pose, *pose.alternatives]
            candidates = [build_candidate(self.camera, self.config, table, hypothesis) for hypothesis in hypotheses]
            candidates = rank(self.camera, self.config, candidates)
            plane = self._vote_of_plane(reference, current, pose, candidates) if self._third_view else None
            if plane is not None and plane.reversed().decides():
                candidates[:2] = candidates[1::-1]
                plane = plane.reversed()
        attempt = replace(attempt, frames=(*attempt.frames, *table.frames[2:]))
        best = candidates[0]
        if not isinstance(best.bundle, BundleSolution):
            return refused(attempt, "bundle_adjustment_failed", {"cause": best.bundle.cause})
        verdict, evidence = self._vote(candidates if self._third_view else candidates[:1], plane)
        attempt = replace(attempt, evidence=attempt.evidence | evidence)
        if verdict != ACCEPTED:
            return refused(attempt, verdict)
        verdict, gates = acceptance.check(self.camera, best, best.bundle, self.config.acceptance)
        evidence = {"reprojection_rmse_px": best.bundle.rmse_px, "lacking": max(gate.lacking() for gate in gates)}
        for gate in gates:
            evidence |= {gate.name: gate.value, f"{gate.name}_gate": gate.threshold}
        attempt = replace(attempt, evidence=attempt.evidence | evidence)
        if verdict == "no_third_view" and not self._third_view:
            verdict = ACCEPTED
        two_views_only = verdict == "no_third_view" and len(table.frames) == 2 and len(candidates) == 1
        if verdict == ACCEPTED or two_views_only:
            turning = turning_camera(m[pose.inliers], n[pose.inliers], pose.noise_rad)
            # The noise, and what tracks share.
            systematic_rad = 1e-3 * self.config.acceptance.systematic_error_mrad
            expected_rad = float(np.hypot(best.bundle.noise_px / self.camera.focal_px, systematic_rad))
            residual, needed = turning.residual_rad / expected_rad, self.config.acceptance.min_turning_residual
            evidence = {"turning_focal_factor": turning.focal_factor}
            evidence |= {"turning_residual": residual, "turning_residual_gate": needed}
            attempt = replace(attempt, evidence=attempt.evidence | evidence)
            if residual < needed:
                return refused(attempt, "pure_rotation", {"lacking": needed / residual})
            # The frames themselves: at the end of the sequence the history may have forgotten them.
            seen = tuple(self.history[frame] for frame in best.bundle.problem.frames)
            accepted = _Acceptance(best.bundle, pose.kind, seen)
            if verdict == ACCEPTED:
                self._accepted = accepted
                return attempt
            self._two_views_only = attempt, accepted
        return refused(attempt, verdict)

    def _two_view_verdict(self, attempt: Attempt, pose: RelativePose | NoPose) -> tuple[str, Evidence]:
        """What two views alone refuse, before any map is built."""
        settings = self.config.acceptance
        if isinstance(pose, NoPose):
            return pose.reason, {}
        if pose.kind == "rotation":
            moved_px = np.linalg.norm(attempt.pixels2 - attempt.pixels1, axis=1)[pose.inliers]
            gate_px = difference_gate(max(self.config.map.noise_px, pose.noise_rad * self.camera.focal_px))
            motion_px = float(np.percentile(moved_px, 90))
            evidence: Evidence = {"explained_motion_px": motion_px, "motion_gate_px": gate_px}
            return ("static_camera" if motion_px < gate_px else "pure_rotation"), evidence
        if pose.inliers.mean() < self.config.two_view.min_inlier_share:
            return "no_consistent_motion", {"inlier_share_gate": self.config.two_view.min_inlier_share}
        # Further views and the adjustment bring the uncertainty down by about the square root of their number: a pair
        # whose single standard deviation is beyond what three of the map may be is too early by far, and so is one
        # whose parallax is not above what no average removes.
        systematic_rad = 1e-3 * settings.systematic_error_mrad / max(pose.parallax_rad, 1e-12)
        bound_deg = float(np.degrees(max(pose.direction_sigma_rad, systematic_rad)))
        if bound_deg > settings.max_direction_error_deg:
            lacking = bound_deg / settings.max_direction_error_deg
            return "low_parallax", {"two_view_direction_bound_deg": bound_deg, "lacking": lacking}
        return ACCEPTED, {}

    def _vote_of_plane(
        self, reference: Observations, current: Observations, pose: RelativePose, candidates: list[MapCandidate]
    ) -> Margin | None:
        """The vote of all views between the two maps of a plane, with the plane as a constraint."""
        solved = [c for c in candidates if isinstance(c.bundle, BundleSolution)]
        if pose.kind != "planar" or len(solved) != 2 or same_map(*solved):
            return None
        voters = table_of(reference, current, voting_views(self.history, reference, current, self.config.map))
        return plane_margin(voters, solved[0].hypothesis, solved[1].hypothesis, pose.noise_rad)

    def _vote(self, candidates: list[MapCandidate], plane: Margin | None) -> tuple[str, Evidence]:
        """Whether the best map is better than each of its rivals, beyond doubt: as free points, or as a plane."""
        best, *rivals = candidates
        verdict, evidence = ACCEPTED, Evidence()
        for k, rival in enumerate(rivals, start=1):
            if same_map(best, rival):
                continue
            free = margin(self.camera, self.config, best, rival)
            evidence |= {f"rival{k}_log_likelihood": free.log_likelihood, f"rival{k}_z": free.z}
            margins = [free]
            if k == 1 and plane is not None:
                evidence |= {"plane_log_likelihood": plane.log_likelihood, "plane_z": plane.z}
                margins.append(plane)
            against = any(m.reversed().decides() for m in margins)
            if against or not any(m.decides() for m in margins):
                verdict = "ambiguous_plane"
        return verdict, evidence

    # -- outcome ----------------------------------------------------------------------------------

    def _hand_over(self, accepted: _Acceptance) -> None:
        self.map = initial_map(accepted.bundle, accepted.views, accepted.scene)
        self.recorder.initialized(self.map, accepted.views)

    def _remember(self, attempt: Attempt) -> None:
        self.recorder.attempt(attempt)
        self._attempts.append(without_matches(attempt))


def _pose_evidence(pose: RelativePose | NoPose, camera: Camera) -> Evidence:
    evidence: Evidence = {f"two_view_{name}": value for name, value in pose.evidence.items() if name != "noise_rad"}
    if isinstance(pose, RelativePose):
        evidence |= {
            "two_view_kind": pose.kind,
            "two_view_alternatives": len(pose.alternatives),
            "two_view_noise_px": pose.noise_rad * camera.focal_px,
            "two_view_parallax_deg": float(np.degrees(pose.parallax_rad)),
            "two_view_direction_sigma_deg": float(np.degrees(pose.direction_sigma_rad)),
        }
    return evidence
