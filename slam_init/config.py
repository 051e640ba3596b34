"""Every number that a user may want to change, with the reason for its default.

The tree is written as ``config.toml`` beside the results and read back with ``--config``; unknown keys are refused.
Names that end in ``_px`` are pixels of the original image; ``min_distance`` is a share of the image width. The noise of
the tracks is measured, and most gates are multiples of it.
"""

from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_type_hints

from slam_init.errors import ConfigError

__all__ = [
    "AcceptanceConfig",
    "Config",
    "KeyframeConfig",
    "MapConfig",
    "TrackingConfig",
    "TwoViewConfig",
    "config_toml",
    "load_config",
]

#: Where a number beyond a range crashes a library, or never ends.
_RANGES: dict[str, tuple[float, float]] = {
    "tracking.max_tracks": (10, 100_000),
    "tracking.window_px": (3, 201),
    "tracking.pyramid_levels": (1, 10),
    "tracking.sift_features": (10, 100_000),
    "tracking.sift_frames": (1, 100),
    "keyframes.window": (1, 1000),
    "keyframes.retry_gain": (1, 1000),
    "keyframes.max_retry_gain": (1, 1000),
    "map.max_further_views": (1, 100),
    "map.min_motion_share": (0, 1),
    "map.max_voting_views": (1, 100),
}


@dataclass(frozen=True)
class TrackingConfig:
    """Features and tracks (:mod:`slam_init.frontend.tracks`)."""

    #: Corners followed at a time. The direction of the baseline gets more certain with their square root; 800 keep
    #: one core within a 30 Hz frame.
    max_tracks: int = 800
    #: Corners are kept this far apart, as a share of the image width: 8 px of 640, so that they spread.
    min_distance: float = 0.0125
    #: New corners are sought when this share of the wanted ones is lost.
    refill_share: float = 0.25
    #: Window and pyramid of the Lucas-Kanade tracker: a 21 px window over 4 octaves follows 80 px of motion.
    window_px: int = 21
    pyramid_levels: int = 3
    #: Forward and backward tracks must meet within this: a track off by more is not a 1 px measurement.
    forward_backward_px: float = 0.7
    #: Below this share of surviving tracks, descriptors are tried as well and the better link wins: half of the tracks
    #: gone from one frame to the next is not video any more (or a cut, a blurred frame).
    flow_survival: float = 0.5
    #: SIFT keypoints an image, Lowe's ratio, and how many of the last frames a new frame is matched with.
    sift_features: int = 2500
    sift_ratio: float = 0.8
    sift_frames: int = 4


@dataclass(frozen=True)
class KeyframeConfig:
    """Keyframe manager (:mod:`slam_init.frontend.keyframes`)."""

    #: Candidate reference frames kept at a time: each costs about a millisecond a frame, and eight reach back over 70
    #: frames of slow video.
    window: int = 8
    #: A frame becomes a candidate when it shares less than this with the last candidate ...
    new_overlap: float = 0.8
    #: ... or, in a slow video, after so many frames.
    new_after_frames: int = 10
    #: A pair needs this many common tracks: the epipolar geometry has five unknowns, a decision between two motions
    #: needs votes by the dozen (see quest.alternatives.decides).
    min_matches: int = 40
    #: A pair is tried again when it promises this much more than at its last failure, or after a while: trying each
    #: frame costs time and brings the same answer.
    retry_gain: float = 1.15
    #: A failure by a wide margin waits for more, but for no more than this: the scene may change.
    max_retry_gain: float = 3.0


@dataclass(frozen=True)
class TwoViewConfig:
    """Two-view bootstrap (:mod:`quest.estimate`)."""

    #: Outlier threshold in pixels: three standard deviations of a 0.7 px feature. The estimator lowers it where the
    #: tracks are better.
    threshold_px: float = 2.0
    #: The motion must explain this share of the common tracks: a scene of which more moves by itself is not one that a
    #: single rigid motion describes.
    min_inlier_share: float = 0.5


@dataclass(frozen=True)
class MapConfig:
    """Triangulation, further views and bundle adjustment."""

    #: Views in the map besides the pair: enough to tell a plane from its twin and to average the tracks' noise; every
    #: one costs bundle adjustment time.
    max_further_views: int = 4
    #: Views that vote where a plane has two explanations: their points need no adjustment, so there may be more.
    max_voting_views: int = 8
    #: Further views have at least this share of the pair's baseline, where there are such: the error of a baseline's
    #: direction grows with the inverse of its length, by a third here.
    min_motion_share: float = 0.75
    #: A further view must see this many of the map's landmarks: 40 coordinates for six unknowns leave enough over to
    #: disagree with a wrong map.
    min_resected: int = 20
    #: Landmarks whose relative depth is less certain than this are left out (one standard deviation): from here on one
    #: in 160 would lie behind the camera by noise alone (2.5 deviations).
    max_depth_sigma: float = 0.4
    #: Residuals beyond this many standard deviations are outliers: one in 3000 of a 2-D Gaussian. At three, one in 90
    #: right observations is lost, and more where the noise is underestimated: poses were a fifth less accurate.
    outlier_sigmas: float = 4.0
    #: Noise of a track before the residuals tell better: two to five times what flow shows on sharp video, so that blur
    #: and drift are not taken for motion.
    noise_px: float = 0.5
    #: No estimate goes below this: errors that tracks share (drift, lens) are not seen in their residuals.
    min_noise_px: float = 0.1
    #: Whether the focal length is adjusted with the map. A few views that hardly turn cannot tell it, and a calibration
    #: is mostly better than what they say; worth it where the stated one is from a data sheet, or from memory.
    refine_focal: bool = False
    #: How far the stated focal length may be off then: relative standard deviation of the prior. Data sheets and zoom
    #: scales are off by a twentieth; for a guess from the image size take 0.3.
    focal_sigma: float = 0.05


@dataclass(frozen=True)
class AcceptanceConfig:
    """When a map is handed over (:mod:`slam_init.decision.map_gates`)."""

    #: As in ORB-SLAM and stella_vslam: what tracking goes on from.
    min_landmarks: int = 50
    #: Bound on the error of the direction of the baseline: three standard deviations and what tracks share. A map
    #: is wrong from 15 degrees on; a third of that is left for what a noise model does not hold.
    max_direction_error_deg: float = 10.0
    #: Error that tracks share and that does not average out. It is measured for each pair
    #: (:mod:`slam_init.decision.correlated_error`); less than this is not believed, since what a motion took in does not show: three
    #: times the 0.05 px by which interpolation between pixels misleads a tracker.
    min_correlated_error_px: float = 0.15
    #: By what share the focal length may be off, as those of data sheets and zooms are: the direction may not turn by
    #: more than the bound if it is.
    focal_error: float = 0.05
    #: Median relative uncertainty of the landmarks' depths (one standard deviation). One degree of parallax, which
    #: ORB-SLAM and stella_vslam ask for, is 0.18 at 1 px of noise and a focal length of 460 px.
    max_median_depth_sigma: float = 0.18
    #: Share of the pair's tracks that are landmarks in the end: where most of what is seen does not follow the motion,
    #: or has no measurable depth, the motion may be that of something else.
    min_explained: float = 0.5
    #: What a turning camera with a focal length off by up to a tenth leaves of the matches must be more than noise and
    #: three times what tracks share, or there may be no translation at all: their ratio, after four standard deviations
    #: of chance.
    min_rotation_only_residual: float = 1.0
    #: Share of the landmarks' observations by further views that agree with the two-view map: as many as a scene with
    #: 30 % of moving objects can have. Sound maps showed 0.9 and more.
    min_further_agreement: float = 0.7


@dataclass(frozen=True)
class Config:
    """All options of a run."""

    method: str = "quest"
    seed: int = 0
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    keyframes: KeyframeConfig = field(default_factory=KeyframeConfig)
    two_view: TwoViewConfig = field(default_factory=TwoViewConfig)
    map: MapConfig = field(default_factory=MapConfig)
    acceptance: AcceptanceConfig = field(default_factory=AcceptanceConfig)


def load_config(path: Path | None, overrides: dict[str, Any] | None = None) -> Config:
    """Read a TOML file over the defaults, then apply top-level overrides (None values are ignored).

    Raises
    ------
    ConfigError
        Where the file cannot be read or parsed, or holds an unknown key or a value of the wrong type.
    """
    table: dict[str, Any] = {}
    if path is not None:
        try:
            if path.exists() and not path.is_file():  # a pipe would be waited for
                raise ConfigError(f"cannot read {path}: it is no regular file")
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"cannot read {path}: {error.strerror or error}") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path} is not valid TOML: {error}") from None
    table |= {key: value for key, value in (overrides or {}).items() if value is not None}
    config: Config = _build(Config, table, where=str(path) if path else "options", prefix="")
    return config


def config_toml(config: Config) -> str:
    """The resolved configuration as TOML text that :func:`load_config` reads back."""
    import tomli_w

    return tomli_w.dumps(dataclasses.asdict(config))


def _build(cls: Any, table: dict[str, Any], where: str, prefix: str) -> Any:
    types = get_type_hints(cls)
    values = {}
    for key, value in table.items():
        if key not in types:
            known = ", ".join(types)
            raise ConfigError(f"{where}: unknown key {prefix + key!r}; known here: {known}")
        wanted = types[key]
        if dataclasses.is_dataclass(wanted):
            if not isinstance(value, dict):
                raise ConfigError(f"{where}: {prefix + key} must be a table")
            values[key] = _build(wanted, value, where, f"{prefix}{key}.")
        else:
            values[key] = _number_or_text(wanted, value, where, prefix + key)
    return cls(**values)


def _number_or_text(wanted: type, value: Any, where: str, key: str) -> Any:
    if wanted is float and type(value) is int:
        value = float(value)
    if type(value) is not wanted:
        raise ConfigError(f"{where}: {key} must be of type {wanted.__name__}, not {value!r}")
    if wanted is bool:
        return value
    least, most = _RANGES.get(key, (float("-inf"), float("inf")))
    if isinstance(value, int | float) and not least <= value <= most:
        raise ConfigError(f"{where}: {key} is {value!r}: it must lie in {least} .. {most}")
    # Sizes, counts and thresholds all are positive numbers; the seed may be zero.
    if isinstance(value, int | float) and not (0 < value < float("inf") or (key == "seed" and value == 0)):
        raise ConfigError(f"{where}: {key} is {value!r}: it must be a positive number")
    return value
