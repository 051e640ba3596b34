"""The names of the methods, their descriptions, and how they are made.

The module imports no heavy library, because the command line reads it. A method of your own needs no entry here:
``--method package.module:Class`` or ``--method FILE.py:Class`` takes any
:class:`~slam_init.methods.two_view.TwoViewMethod` (see ``docs/examples/add_a_method.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from importlib.util import find_spec
from types import BuiltinFunctionType
from typing import TYPE_CHECKING, Any, Protocol

from slam_init.errors import ConfigError
from slam_init.methods.external_command import is_external, parse_external
from slam_init.system.user_code import attribute_of, described_error

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slam_init.config import Config
    from slam_init.frontend.tracks import History, Tracker
    from slam_init.recording.recorder import Recorder
    from slam_init.types.arrays import Image
    from slam_init.types.camera import Camera
    from slam_init.types.frame import Frame, Observations
    from slam_init.types.initial_map import InitialMap
    from slam_init.types.result import Result
    from slam_init.types.status import Status


class FrontEnd(Protocol):
    """The interface of an initializer: it takes frames until it has a map."""

    status: Status

    @property
    def frames_read(self) -> int:
        """Number of frames that it was given."""

    @property
    def tracker(self) -> Tracker:
        """Follows the tracks."""

    @property
    def history(self) -> History:
        """The observations of the last frames."""

    @property
    def map(self) -> InitialMap | None:
        """The accepted map; None before."""

    def process(self, image: Image | Frame, timestamp_s: float | None = None) -> Status:
        """Process the next image (H, W)."""

    def process_tracks(self, current: Observations, *, revised: Sequence[Observations] = ()) -> Status:
        """Process the tracks of the next frame, which were found elsewhere."""

    @property
    def result(self) -> Result:
        """The result up to now."""

    def reset(self, since: int | None = None) -> None:
        """Start anew with the same camera and tracks.

        * ``since``: Absolute index of the first frame whose tracks the next map may use; by default the newest one.
        """

    def finish(self) -> Result:
        """End the sequence."""


@dataclass(frozen=True)
class MethodInfo:
    """The description of a method."""

    name: str
    #: One line.
    summary: str
    #: Source of its rules.
    source: str
    #: ``package.module:attribute``; the attribute, called without arguments, returns a
    #: :class:`~slam_init.methods.two_view.TwoViewMethod`. Empty for the methods of :mod:`slam_init.initializer`.
    home: str = ""
    #: An optional package that the method needs.
    needs: str | None = None
    #: The same method has this name as well. By default a comparison runs it once.
    alias_of: str | None = None


_HERE = "slam_init.methods"

#: The methods by name; those of this project come first.
METHODS: dict[str, MethodInfo] = {
    info.name: info
    for info in (
        MethodInfo(
            "quest",
            "QuEst; the stated risk of the joint estimate of all views decides",
            "this project; Fathian et al. 2017, arXiv:1704.02672",
        ),
        MethodInfo(
            "quest-two-view", "the same without a third view: the joint estimate holds the pair alone", "this project"
        ),
        MethodInfo(
            "orb-slam3",
            "8-point F and H, H where its score is above 0.50 of both, 4 or 8 motions checked",
            "ORB-SLAM3 v1.0, TwoViewReconstruction; Campos et al., T-RO 2021",
            f"{_HERE}.orb_slam:orb_slam3",
        ),
        MethodInfo(
            "orb-slam2",
            "as orb-slam3 with H above 0.40, and 100 landmarks after bundle adjustment",
            "ORB-SLAM2, Initializer; Mur-Artal and Tardos, T-RO 2017",
            f"{_HERE}.orb_slam:orb_slam2",
        ),
        MethodInfo(
            "stella",
            "8-point F and 4-point H, the one of less truncated cost, 4 or 8 motions checked",
            "stella_vslam, initialize/perspective",
            f"{_HERE}.stella:Stella",
        ),
        MethodInfo(
            "essential-5pt",
            "OpenCV's five-point USAC_MAGSAC, most points in front, parallax gate",
            "OpenCV, findEssentialMat; Barath et al., CVPR 2020",
            f"{_HERE}.essential:EssentialFivePoint",
        ),
        MethodInfo(
            "essential-8pt",
            "normalized 8-point E, most points in front, parallax gate",
            "Hartley, PAMI 1997",
            f"{_HERE}.essential:EssentialEightPoint",
        ),
        MethodInfo(
            "homography",
            "a plane, always: H, the motion of most points in front, 50 px of disparity",
            "SVO, KltHomographyInit; Forster et al., ICRA 2014",
            f"{_HERE}.homography:PlaneOnly",
        ),
        MethodInfo(
            "colmap",
            "five-point E or H by the ratio of their inliers, 16 degrees of parallax",
            "COLMAP, two-view geometry and initial pair; Schoenberger and Frahm, CVPR 2016",
            f"{_HERE}.colmap:Colmap",
        ),
        MethodInfo(
            "poselib",
            "PoseLib's five-point LO-RANSAC, parallax gate",
            "PoseLib, estimate_relative_pose; Larsson 2020",
            f"{_HERE}.poselib:PoseLib",
            needs="poselib",
        ),
        MethodInfo(
            "poselib-100",
            "as poselib with at least 100 iterations in place of 1000, as in the benchmark of its authors",
            "PoseLib, estimate_relative_pose and its benchmark; Larsson 2020",
            f"{_HERE}.poselib:poselib_100",
            needs="poselib",
        ),
        MethodInfo(
            "magsac",
            "another name of essential-5pt: OpenCV's five-point USAC_MAGSAC, parallax gate",
            "OpenCV, findEssentialMat; Barath et al., CVPR 2020",
            f"{_HERE}.essential:EssentialFivePoint",
            alias_of="essential-5pt",
        ),
        MethodInfo(
            "poselib-window",
            "PoseLib's relative pose in place of QuEst, judged by the window of quest",
            "this project, with PoseLib's estimate_relative_pose",
            needs="poselib",
        ),
        MethodInfo(
            "superansac",
            "SupeRANSAC's five-point essential matrix with uniform samples, parallax gate; not deterministic",
            "pysuperansac, estimateEssentialMatrix; Barath 2025, arXiv:2506.04803",
            f"{_HERE}.superansac:SupeRansac",
            needs="pysuperansac",
        ),
        MethodInfo(
            "opensfm",
            "rotation-only test, then five-point or plane-based motion by their inliers, 20 points of 1 degree",
            "OpenSfM, two_view_reconstruction_general; Mapillary",
            f"{_HERE}.opensfm:OpenSfm",
        ),
        MethodInfo(
            "pyslam",
            "five-point MAGSAC on pairs of 2 to 5 frames, 150 points, a point in each ninth of the image",
            "pySLAM, Initializer; Freda 2025, arXiv:2502.11955",
            f"{_HERE}.pyslam:PySlam",
        ),
    )
}


def method_info(name: str) -> MethodInfo:
    """Describe a method.

    * ``name``: A name of :data:`METHODS`, ``package.module:attribute``, or ``command:PROGRAM ...``.
    """
    if name in METHODS:
        return METHODS[name]
    if is_external(name):
        return MethodInfo(name, "an external program", " ".join(parse_external(name).words))
    if ":" in name:
        return MethodInfo(name, "a method of your own", name, home=name)
    meant = get_close_matches(name.lower(), METHODS, n=1, cutoff=0.7)
    hint = f"did you mean {meant[0]}? " if meant else ""
    raise ConfigError(
        f"unknown method {name!r}: {hint}slam-init run --list-methods names all; one of your own is "
        "package.module:attribute, FILE.py:attribute or 'command:PROGRAM {images} {times} {camera} {out}'"
    )


def methods_text() -> str:
    """List the methods for people, one a line, with the packages that are not installed."""
    width = max(len(name) for name in METHODS)
    lines = []
    for name, info in METHODS.items():
        lacking = info.needs is not None and find_spec(info.needs) is None
        lines.append(f"{name:{width}}  {info.summary}" + (f" (pip install {info.needs})" if lacking else ""))
    return "\n".join(lines) + "\n"


def make_two_view(name: str) -> Any:
    """Make the two-view method of a name."""
    info = method_info(name)
    if not info.home:
        raise ConfigError(f"{name} is not a two-view method: use make_initializer")
    if info.needs is not None and find_spec(info.needs) is None:
        raise ConfigError(f"the method {name} needs the package {info.needs}: pip install {info.needs}")
    try:
        make = attribute_of(info.home)
        if isinstance(make, BuiltinFunctionType) or not callable(make):  # sys:exit
            raise ConfigError(f"{name!r} is not a two-view method: give package.module:Class")
        method = make()
    except ConfigError:
        raise
    except (Exception, SystemExit) as error:  # the module of somebody else may raise anything
        raise ConfigError(f"the method {name!r} cannot be made: {described_error(error)}") from error
    if not hasattr(method, "bootstrap") or not hasattr(method, "pair_rule"):
        raise ConfigError(f"{name!r} is not a two-view method: it has no bootstrap, or no pair_rule")
    return method


def make_initializer(name: str, camera: Camera, config: Config, recorder: Recorder | None = None) -> FrontEnd:
    """Make an initializer that uses a method.

    * ``name``: A name of :data:`METHODS`, ``package.module:attribute``, or ``command:PROGRAM ...``.
    """
    if is_external(name):
        from slam_init.methods.external import ExternalInitializer

        return ExternalInitializer(name, camera, config, recorder)
    from slam_init.initializer import Initializer

    info = method_info(name)
    if info.name == "poselib-window":
        if find_spec("poselib") is None:
            raise ConfigError(f"the method {name} needs the package poselib: pip install poselib")
        from slam_init.methods.poselib import propose

        return Initializer(camera, config, recorder, propose=propose)
    if not info.home:
        return Initializer(camera, config, recorder, third_view=info.name != "quest-two-view")
    from slam_init.methods.pair_initializer import PairInitializer

    return PairInitializer(make_two_view(name), camera, config, recorder)
