"""Every number that a user may want to change, with the reason for its default.

The configuration is written as ``config.toml`` beside the results and read back with ``--config``; unknown keys are
refused. Names that end in ``_px`` are pixels of the original image; ``min_distance`` is a share of the image width.
"""

from __future__ import annotations

import dataclasses
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar, get_type_hints

from quest.display import Described
from slam_init.errors import ConfigError
from slam_init.system.regular_file import read_regular, user_path

_Options = TypeVar("_Options")

# All options take 4 kB.
_MAX_BYTES = 200_000


def _within(default: Any, least: float, most: float, reason: str) -> Any:
    """An option with its range, and the reason: outside of it a library fails, a run never ends, or nothing is left."""
    return field(default=default, metadata={"range": (least, most, reason)})


class _Section:
    """A section of the options, with its name in a file. It refuses numbers out of their range."""

    _name: ClassVar[str]

    def __init_subclass__(cls, *, name: str) -> None:
        cls._name = name

    def __post_init__(self) -> None:
        _check_ranges(self, f"{self._name}.")


@dataclass(frozen=True)
class TrackingConfig(_Section, name="tracking"):
    """Features and tracks (:mod:`slam_init.frontend.tracks`)."""

    #: Number of corners that are followed at a time. The standard deviation of the baseline's direction falls with the
    #: square root of the number.
    max_tracks: int = _within(800, 10, 100_000, "a motion needs some tracks, and time grows with their number")
    #: Least distance between corners, as a share of the image width: 8 px of 640, so that the corners spread.
    min_distance: float = _within(0.0125, 0.0001, 0.2, "a share of the image width; at a fifth 25 corners are left")
    #: New corners are detected when this share of ``max_tracks`` is lost.
    refill_share: float = _within(0.25, 0.001, 1, "a share")
    #: Window and pyramid of the Lucas-Kanade tracker: a window of 21 px over 4 octaves follows 80 px of motion.
    window_px: int = _within(21, 3, 201, "the patches have to lie in the image")
    pyramid_levels: int = _within(3, 1, 10, "2^10 px are more than an image")
    #: Largest distance between a corner and its track followed forward and backward: a track that misses by more does
    #: not have the accuracy of 1 px.
    forward_backward_px: float = _within(0.7, 0.001, 1000, "pixels")
    #: If fewer tracks than this share survive, SIFT descriptors are matched as well and the better link is used. Video
    #: does not lose half of its tracks from one frame to the next; a photo set, a cut or a blurred frame does.
    flow_survival: float = _within(0.5, 0.001, 1, "a share")
    #: SIFT keypoints per image, Lowe's ratio, and the number of last frames that a new frame is matched with.
    sift_features: int = _within(2500, 10, 100_000, "time grows with the square of their number")
    sift_ratio: float = _within(0.8, 0.01, 1, "a ratio of distances, the smaller one first")
    sift_frames: int = _within(4, 1, 100, "each is matched with a new frame")
    #: What links the frames in the place of the flow: ``sift``, ``orb``, ``lightglue``, ``hloc:FEATURES,MATCHER`` or
    #: ``module:attribute`` (:mod:`slam_init.frontend.matchers`). Empty for the flow.
    matcher: str = ""


@dataclass(frozen=True)
class KeyframeConfig(_Section, name="keyframes"):
    """Keyframe manager (:mod:`slam_init.frontend.keyframes`)."""

    #: Number of candidate reference frames: each costs up to a quarter of a millisecond a frame, and eight of them
    #: reach back over 70 frames of slow video.
    window: int = _within(8, 1, 1000, "each is previewed with a new frame")
    #: A frame becomes a candidate when it shares fewer tracks than this share with the last candidate ...
    new_overlap: float = _within(0.8, 0.001, 1, "a share")
    #: ... or, in a slow video, after this number of frames.
    new_after_frames: int = _within(10, 1, 1_000_000, "frames")
    #: Least number of common tracks of a pair: as many as the landmarks that a map needs.
    min_matches: int = _within(30, 6, 100_000, "five matches fix a motion, and one more tests it")
    #: A pair is tried again when its direction score is higher by this factor than at its last failure, or after a
    #: wait: a try at every frame costs time and gives the same result.
    retry_gain: float = _within(1.15, 1, 1000, "a factor that grows")


@dataclass(frozen=True)
class TwoViewConfig(_Section, name="two_view"):
    """Relative pose of a pair (:mod:`quest.estimate`)."""

    #: Outlier threshold in pixels: three standard deviations of a feature with 0.7 px of noise. The estimator lowers
    #: the threshold where the tracks are better.
    threshold_px: float = _within(2.0, 0.01, 1000, "pixels, below a quarter of an image")


@dataclass(frozen=True)
class MapConfig(_Section, name="map"):
    """Triangulation, further views and bundle adjustment."""

    #: Least number of tracks that a further view must see: 40 coordinates for six unknowns can contradict a wrong
    #: motion.
    min_resected: int = _within(20, 4, 100_000, "three points fix a pose, and one more tests it")
    #: Landmarks with a larger relative standard deviation of the depth are dropped: beyond this value one in 160 would
    #: lie behind the camera by noise alone (2.5 standard deviations).
    max_depth_sigma: float = _within(0.4, 0.001, 10, "a share of the depth")
    #: Residuals beyond this number of standard deviations are outliers: one in 3000 of a 2-D Gaussian. With three
    #: standard deviations one in 90 correct observations is lost, and more where the noise is underestimated: the poses
    #: were a fifth less accurate.
    outlier_sigmas: float = _within(4.0, 1, 100, "standard deviations: a third of Gaussian errors is beyond one")
    #: Noise of a track before it is measured: two to five times the noise of optical flow on sharp video, so that blur
    #: and drift do not count as motion.
    noise_px: float = _within(0.5, 0.001, 100, "pixels")
    #: Lower limit of the measured noise: correlated tracking errors (drift, lens) do not show in the residuals.
    min_noise_px: float = _within(0.1, 0.001, 100, "pixels")
    #: Whether bundle adjustment adjusts the focal length. A few views with little rotation cannot determine it, and a
    #: calibration is mostly better; the option helps where the stated focal length is from a data sheet or a guess.
    refine_focal: bool = False
    #: Relative standard deviation of the prior of the focal length: data sheets and zoom scales are off by 5 %; for a
    #: guess from the image size use 0.3.
    focal_sigma: float = _within(0.05, 0.0001, 1, "a share of the focal length")
    #: Factor on what a calibration leaves open in the covariances of the map: 2 % of the focal length, 0.025 of the
    #: width for the principal point, and 0.01 for a stated k1 (0.05 for one that is not stated). With 0 the lens is
    #: exact, and the graph holds it.
    lens_uncertainty: float = _within(1.0, 0, 100, "0 for an exact lens")


@dataclass(frozen=True)
class AcceptanceConfig(_Section, name="acceptance"):
    """What a map has to reach (:mod:`slam_init.decision.window_rule`)."""

    #: Largest probability that a map is wrong by the model of the joint estimate of all views: one map in 200. What no
    #: model has comes on top (:data:`slam_init.types.initial_map.UNMODELLED_RISK`), and nothing lowers it.
    max_risk: float = _within(0.005, 0.0011, 1, "a probability; 0.001 of it is for what is not modelled")
    #: Factor on the probability that focus or a stabilizer changes the lens from view to view, which short baselines
    #: before a plane do not distinguish from a motion. 0: the focus is fixed and nothing stabilizes the images.
    lens_changes: float = _within(1.0, 0, 5, "0 for a lens that is fixed; with 5 every second lens changes")
    #: Least number of landmarks: COLMAP registers an image by 30 of them. Whether they determine a pose is another gate
    #: (:mod:`slam_init.decision.depths`).
    min_landmarks: int = _within(30, 4, 100_000, "three points fix a pose, and one more tests it")
    #: A depth is known up to this relative standard deviation, and three quarters of the landmarks need known depths
    #: (:mod:`slam_init.decision.depths`). A prediction is off by 10 pixels then where the parallax is 50. A smaller
    #: value makes the initializer wait for more parallax.
    max_depth_sigma: float = _within(0.2, 0.002, 0.2, "a tracker needs 0.2, and the scale of a map is held to 0.001")
    #: Least median parallax of the landmarks in degrees; no bound by default: ``max_depth_sigma`` knows the noise too.
    min_parallax_deg: float = _within(0.0, 0, 90, "rays that meet at a right angle give the best depth")


@dataclass(frozen=True)
class ExternalConfig(_Section, name="external"):
    """Limits of an external method (:mod:`slam_init.methods.external`)."""

    #: The program is killed after this number of seconds: the time of a trial of ``slam-init compare``.
    time_limit_s: float = _within(300.0, 0.1, 1e6, "eleven days")
    #: Limit of the address space of each of its processes, in MB. A program that uses a GPU reserves more.
    memory_limit_mb: int = _within(6000, 10, 1e9, "a program needs some memory")
    #: Largest number of frames that the program gets: ten seconds of video.
    max_frames: int = _within(300, 2, 100_000, "a pair, and what a disk holds")


@dataclass(frozen=True, repr=False)
class Config(Described):
    """All options of a run.

    Attributes
    ----------
    method : str
        Name of the method (``quest``, ``orb-slam3``, ...), ``package.module:attribute``, or ``command:PROGRAM ...``.
    seed : int
        Seed of all random draws and of synthetic worlds.
    refine_frames : int or None
        Number of frames after the acceptance by which the map grows before it is exported; 0 for none. None: a run
        hands it over at once, and an initializer that gets further frames as soon as the median deviation of its
        depths, with all errors, is at most ``acceptance.max_depth_sigma`` (:mod:`slam_init.decision.map_candidates`).
    tracking : TrackingConfig
        Features and tracks.
    keyframes : KeyframeConfig
        Keyframe manager.
    two_view : TwoViewConfig
        Relative pose of a pair.
    map : MapConfig
        Triangulation, further views and bundle adjustment.
    acceptance : AcceptanceConfig
        What a map has to reach.
    external : ExternalConfig
        Limits of an external method.
    """

    method: str = "quest"
    seed: int = _within(0, 0, 2**63 - 1, "it is stored in 64 bits")
    refine_frames: int | None = _within(None, 0, 1_000_000, "frames; None grows until the depths are known")
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    keyframes: KeyframeConfig = field(default_factory=KeyframeConfig)
    two_view: TwoViewConfig = field(default_factory=TwoViewConfig)
    map: MapConfig = field(default_factory=MapConfig)
    acceptance: AcceptanceConfig = field(default_factory=AcceptanceConfig)
    external: ExternalConfig = field(default_factory=ExternalConfig)

    def __post_init__(self) -> None:
        for section in _Section.__subclasses__():
            found = getattr(self, section._name)
            if type(found) is not section:
                wanted = f"give a {section.__name__} (from slam_init.config)"
                raise ConfigError(f"{section._name} is of the type {type(found).__name__}: {wanted}")
        _check_ranges(self, "")

    def changed(self) -> dict[str, object]:
        """The options that differ from the defaults.

        Returns
        -------
        dict of str to object
            ``section.option`` -> value.
        """
        defaults = _flat(Config())
        return {name: value for name, value in _flat(self).items() if value != defaults[name]}

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        changed = {k: v for k, v in self.changed().items() if k not in ("method", "seed")}
        facts = [(name, str(value)) for name, value in list(changed.items())[:4]]
        more = [("...", f"{len(changed) - 4} more")] if len(changed) > 4 else []
        rest = "all other options at their defaults" if changed else "all options at their defaults"
        return f"method {self.method}, seed {self.seed}, {rest}", [*facts, *more]


def load_config(path: str | os.PathLike[str] | None, overrides: Mapping[str, object] | None = None) -> Config:
    """Read a TOML file over the defaults, then apply overrides.

    Parameters
    ----------
    path : str, path or None
        The file; without one the defaults hold.
    overrides : mapping of str to object, optional
        Options by their names, as ``seed`` or ``map.noise_px``; those that are None are ignored.

    Returns
    -------
    Config

    Raises
    ------
    ConfigError
        Where the file cannot be read or parsed, or holds an unknown key or a value of the wrong type.
        The name of the method is checked when the method is made.
    """
    table: dict[str, Any] = {}
    if path is not None:
        path = user_path(path, ConfigError)
        try:
            table = tomllib.loads(read_regular(path, _MAX_BYTES, "a configuration", ConfigError).decode("utf-8"))
        # ValueError: no TOML, no UTF-8, or an integer of thousands of digits.
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"{path} is not valid TOML: {error}") from None
    for name, value in (overrides or {}).items():
        section, _, option = name.rpartition(".")
        if value is not None:
            (table.setdefault(section, {}) if section else table)[option] = value
    where = str(path) if path else "options"
    return _build(Config, table, where=where, prefix="")


def config_toml(config: Config) -> str:
    """The resolved configuration as TOML text that :func:`load_config` reads back."""
    import tomli_w

    # TOML has no null: an option that is left out has its default, which is None there.
    return tomli_w.dumps({key: value for key, value in dataclasses.asdict(config).items() if value is not None})


def _check_ranges(options: Any, prefix: str) -> None:
    """Raise ConfigError where a number of a section is out of its range, or is none."""
    for item in dataclasses.fields(options):
        name, value = prefix + item.name, getattr(options, item.name)
        if "range" not in item.metadata or value is None:
            continue
        least, most, reason = item.metadata["range"]
        if type(value) is bool or not isinstance(value, int | float):
            raise ConfigError(f"{name} is {value!r:.40}: give a number from {least:g} to {most:g}")
        number = float(min(max(value, -1e300), 1e300))  # an integer may be too long for a float, and for a line
        if not least <= number <= most:
            raise ConfigError(f"{name} is {number:.10g}: it must lie in {least:g} .. {most:g} ({reason})")


def _flat(config: Config) -> dict[str, object]:
    """``section.option`` -> value."""
    flat: dict[str, object] = {}
    for name, value in dataclasses.asdict(config).items():
        flat |= {f"{name}.{key}": option for key, option in value.items()} if isinstance(value, dict) else {name: value}
    return flat


def _build(cls: type[_Options], table: Mapping[str, object], where: str, prefix: str) -> _Options:
    types = {name: kind for name, kind in get_type_hints(cls).items() if not name.startswith("_")}
    values: dict[str, object] = {}
    for key, value in table.items():
        if key not in types:
            raise ConfigError(f"{where}: unknown key {prefix + key!r}; known here: {', '.join(types)}")
        wanted, name = types[key], prefix + key
        if dataclasses.is_dataclass(wanted) and isinstance(wanted, type):
            if not isinstance(value, dict):
                raise ConfigError(f"{where}: {name} must be a table")
            values[key] = _build(wanted, value, where, f"{name}.")
            continue
        wanted = int if wanted == int | None else wanted
        if wanted is float and isinstance(value, int) and type(value) is not bool and abs(value) < 1e300:
            value = float(value)
        if type(value) is not wanted:
            raise ConfigError(f"{where}: {name} must be of type {wanted.__name__}, not {value!r:.40}")
        values[key] = value
    try:
        return cls(**values)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None
