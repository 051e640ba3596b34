"""The names of the methods, their descriptions, and how they are made.

The module imports no heavy library, because the command line reads it. A method of your own needs no entry here:
``--method package.module:Class`` or ``--method FILE.py:Class`` takes any
:class:`~slam_init.methods.two_view.TwoViewMethod` (see ``docs/examples/add_a_method.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from difflib import get_close_matches
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from slam_init.errors import ConfigError
from slam_init.methods.external_command import is_external, parse_external
from slam_init.system.user_code import attribute_of, described_error

if TYPE_CHECKING:
    from slam_init.config import Config
    from slam_init.initializer import Initializer
    from slam_init.recording.recorder import Recorder
    from slam_init.types.camera import Camera


@dataclass(frozen=True)
class MethodInfo:
    """The description of a method. The sources of its rules are stated where it is defined."""

    name: str
    #: One line.
    summary: str
    #: ``package.module:attribute``; the attribute, called without arguments, returns a
    #: :class:`~slam_init.methods.two_view.TwoViewMethod`. Empty for the methods of :mod:`slam_init.initializer`.
    home: str = ""
    #: An optional package that the method needs.
    needs: str | None = None
    #: The same method has this name as well. By default a comparison runs it once.
    alias_of: str | None = None

    def check_installed(self) -> None:
        """Refuse a method whose package is not installed."""
        if self.needs is not None and find_spec(self.needs) is None:
            raise ConfigError(f"the method {self.name} needs the package {self.needs}: pip install {self.needs}")


#: The methods; those of this project come first. Their homes are modules of this folder.
_DESCRIBED = (
    MethodInfo("quest", "QuEst; the stated risk of the joint estimate of all views decides"),
    MethodInfo("quest-two-view", "the same without a third view: the joint estimate holds the pair alone"),
    MethodInfo(
        "orb-slam3",
        "8-point F, or H above 0.50 of both scores; 50 good points and 90 % of the inliers, 1 degree, no other motion",
        "slam_systems:orb_slam3",
    ),
    MethodInfo(
        "orb-slam2",
        "as orb-slam3 with H above 0.40, and 100 landmarks after bundle adjustment",
        "slam_systems:orb_slam2",
    ),
    MethodInfo(
        "stella",
        "8-point F or 4-point H by truncated cost; 50 good points, 1 degree, no other motion",
        "slam_systems:Stella",
    ),
    MethodInfo(
        "essential-5pt",
        "OpenCV's five-point USAC_MAGSAC; 50 points in front of both cameras, 1 degree",
        "essential:EssentialFivePoint",
    ),
    MethodInfo("essential-8pt", "normalized 8-point E; gates of essential-5pt", "essential:EssentialEightPoint"),
    MethodInfo(
        "homography",
        "a plane, always: H, the motion of most points in front; 50 px of disparity (median), 40 good points",
        "essential:PlaneOnly",
    ),
    MethodInfo(
        "colmap",
        "five-point E or H by the ratio of their inliers; 100 inliers, 16 degrees (median), not forward",
        "sfm_systems:Colmap",
    ),
    MethodInfo("poselib", "PoseLib's five-point LO-RANSAC; gates of essential-5pt", "poselib:PoseLib", needs="poselib"),
    MethodInfo(
        "poselib-100",
        "as poselib with at least 100 iterations in place of 1000, as in the benchmark of its authors",
        "poselib:poselib_100",
        needs="poselib",
    ),
    MethodInfo("magsac", "essential-5pt by another name", "essential:EssentialFivePoint", alias_of="essential-5pt"),
    MethodInfo(
        "poselib-window", "PoseLib's relative pose in place of QuEst, evaluated by the window of quest", needs="poselib"
    ),
    MethodInfo(
        "opensfm",
        "rotation-only test, then five-point or plane-based motion by their inliers, 20 points of 1 degree",
        "sfm_systems:OpenSfm",
    ),
)
#: The methods by name.
METHODS = {one.name: replace(one, home=one.home and f"slam_init.methods.{one.home}") for one in _DESCRIBED}


def method_info(name: str) -> MethodInfo:
    """Describe a method.

    * ``name``: A name of :data:`METHODS`, ``package.module:attribute``, or ``command:PROGRAM ...``.
    """
    if name in METHODS:
        return METHODS[name]
    if is_external(name):
        parse_external(name)
        return MethodInfo(name, "an external program")
    if ":" in name:
        return MethodInfo(name, "a method of your own", home=name)
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
    info.check_installed()
    try:
        method = attribute_of(info.home)()
    except (Exception, SystemExit) as error:  # a third-party module may raise anything
        raise ConfigError(f"the method {name!r} cannot be made: {described_error(error)}") from error
    if not hasattr(method, "bootstrap") or not hasattr(method, "pair_rule"):
        raise ConfigError(f"{name!r} is not a two-view method: give package.module:Class with bootstrap and pair_rule")
    return method


def make_initializer(name: str, camera: Camera, config: Config, recorder: Recorder | None = None) -> Initializer:
    """Make an initializer that uses a method.

    * ``name``: A name of :data:`METHODS`, ``package.module:attribute``, or ``command:PROGRAM ...``.
    """
    if is_external(name):
        from slam_init.methods.external import ExternalInitializer

        return ExternalInitializer(name, camera, config, recorder)
    info = method_info(name)
    if info.home:
        from slam_init.methods.pair_initializer import PairInitializer

        return PairInitializer(make_two_view(name), camera, config, recorder)
    info.check_installed()
    from slam_init.initializer import Initializer

    if name == "poselib-window":
        from slam_init.methods.poselib import propose

        return Initializer(camera, config, recorder, propose=propose)
    return Initializer(camera, config, recorder, third_view=name != "quest-two-view")
