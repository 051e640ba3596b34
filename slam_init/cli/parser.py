"""The parser of the commands, and what several commands take and check: a source of frames and its camera."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from slam_init.errors import SlamInitError, SourceError
from slam_init.methods.registry import methods_text
from slam_init.system.process_io import emit
from slam_init.system.regular_file import user_path

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

    from slam_init.datasets import TimedSource
    from slam_init.datasets.views import SourceView
    from slam_init.types.camera import Camera
    from slam_init.types.frame import Source


Commands: TypeAlias = "argparse._SubParsersAction[Parser]"
DONE, BAD_INPUT, NOT_INITIALIZED = 0, 2, 3
#: Of ``slam-init audit``: the tracks do not decide, as where they do not allow a map; they contradict the map.
DOUBTFUL, WRONG = NOT_INITIALIZED, 4
#: Added to the number of the signal.
INTERRUPTED = 128


OUT_HELP = "results: a new or empty folder, or one of an earlier run of this command (default: %(default)s)"


#: A longer message repeats what somebody typed, or a whole file.
_LONGEST = 400
#: Least likeness of an option to the one that was meant: with less, --calib would be taken for --scale.
_SLIP = 0.75


class UsageError(SlamInitError):
    """The command line itself is wrong."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, reported by :func:`slam_init.cli.main.main` like all others."""

    # The signature of argparse has overloads that say nothing more.
    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse words. An option that does not exist is reported by the command that it was given to."""
        arguments, unknown = super().parse_known_args(args, namespace)
        if unknown:
            nearest = get_close_matches(unknown[0], self._option_string_actions, n=1, cutoff=_SLIP)
            meant = f": did you mean {nearest[0]}?" if nearest else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{meant}")
        for name, value in vars(arguments).items():
            # As a path, the value of a variable that the shell does not know would be the current folder.
            if value == "" or (isinstance(value, list) and "" in value):
                self.error(f"{name} is empty: give a value")
        return arguments, unknown

    def print_help(self, file: SupportsWrite[str] | None = None) -> None:
        """Print the help; a closed pipe is no error."""
        emit(self.format_help())

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong with the arguments. A source in the place of a command is the slip of a first run."""
        typed = re.search(r"COMMAND: invalid choice: '([^']+)'", message)
        if typed and (Path(typed[1]).exists() or ":" in typed[1]):
            message += f": did you mean {self.prog} run {typed[1]}?"
        if len(message) > _LONGEST:  # a number of 5,000 digits
            message = f"{message[: _LONGEST // 2]}...{message[-_LONGEST // 4 :]}"
        raise UsageError(f"{message} (see {self.prog} --help)")


def add_command(
    commands: Commands, name: str, run: Callable[[argparse.Namespace], int], help_: str, description: str
) -> Parser:
    """Add a command.

    * ``run``: Takes the arguments, and returns the exit code.
    * ``help_``: The line in the list of the commands.
    """
    parser = commands.add_parser(name, help=help_, description=description, allow_abbrev=False)
    parser.set_defaults(command=run)
    return parser


class Print(argparse.Action):
    """An option that takes the place of a command: it prints the text that the function ``const`` returns."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """Print the text and exit."""
        assert callable(self.const)
        emit(self.const())
        parser.exit()


def add_list_methods(parser: argparse._ActionsContainer) -> None:
    """Add the option that lists the methods."""
    text = "list the methods, one a line, and exit"
    parser.add_argument("--list-methods", action=Print, nargs=0, const=methods_text, help=text)


def add_options(
    parser: argparse._ActionsContainer,
    helps: Mapping[str, str],
    types: Mapping[str, Callable[[str], object]] | None = None,
    **defaults: object,
) -> None:
    """Add options.

    * ``helps``: The help of each option by its usage: ``--seed N`` takes a value, ``--live [URL]`` may take one and is
      True without it, and ``--json`` takes none and is True or False.
    * ``types``: What reads the value of an option, by its name; text without it.
    * ``defaults``: The values of options that are not given, by their names in the arguments; else None, or False.
    """
    for usage, text in helps.items():
        name, _, value = usage.partition(" ")
        if not value:
            parser.add_argument(name, action="store_true", help=text)
            continue
        kind = (types or {}).get(name, str)
        given: dict[str, Any] = {"nargs": "?", "const": True} if value.startswith("[") else {}
        parser.add_argument(name, metavar=value.strip("[]"), type=kind, help=text, **given)
    parser.set_defaults(**defaults)


def refuse_changed(arguments: argparse.Namespace, defaults: Mapping[str, object], why: str) -> None:
    """Refuse options that have other values than these defaults; ``why`` is said before the name of the option."""
    for name, default in defaults.items():
        if getattr(arguments, name) != default:
            raise UsageError(f"{why} --{name.replace('_', '-')}: leave it out")


def number(least: float, kind: type[float] = int, most: float = math.inf) -> Callable[[str], float]:
    """Make what reads the value of an option that has a smallest and a largest value."""

    def read(text: str) -> float:
        value = kind(text)
        if not least <= value <= most:  # nor is NaN
            bounds = f"at least {least}" if most == math.inf else f"from {least} to {most}"
            raise argparse.ArgumentTypeError(f"{text} is out of range: it must be {bounds}")
        return value

    read.__name__ = kind.__name__
    return read


# -- the source of the frames and its camera ---------------------------------------------------------

#: What the options of several commands do.
MASK = "an image whose black pixels are ignored in all frames, or a folder with NAME.png or NAME.EXT.png a frame"
CAMERA = "calibration, or one number: f=1250 (focal length in pixels), fov=72 (degrees across the longer side)"
TOPICS = {
    "--topic NAME": "images of a ROS bag (default: the only topic with images)",
    "--truth-topic NAME": "true poses of a ROS bag, or 'none' (default: the only topic with poses)",
}
#: Gravity by the accelerations, and not by a table.
BY_IMU = "imu"
#: For messages.
SENSORS = "a EuRoC sequence with imu0, its T_BS, or a ROS bag with sensor_msgs/Imu has one"


def sequence_name(text: str) -> str:
    """Read the name of a source: anything but a folder of results."""
    if user_path(text).is_dir():
        from slam_init.output.report import is_result_folder

        if is_result_folder(user_path(text)):
            raise argparse.ArgumentTypeError(f"{text} is a result of slam-init: use slam-init view {text}, or info")
    return text


def add_source(
    parser: argparse.ArgumentParser,
    default: str | None,
    camera: str = "the calibration of the source, else auto",
    *,
    results: bool = False,
) -> None:
    """Add the source and the options of its camera, of which the default is stated.

    * ``results``: Whether the source may be a folder of results.
    """
    parser.add_argument(
        "source",
        metavar="SOURCE",
        nargs="?" if default else None,
        type=str if results else sequence_name,
        default=default,
        help="a folder (images, or a known data set), a video, a ROS bag, matches (COLMAP's database, .h5, .npz), or "
        "synth:NAME" + (f" (default: {default})" if default else ""),
    )
    helps = {
        "--every N": "use every N-th frame, from the start on",
        "--fps F": "use the frames nearest to F a second, by their times",
        "--mask PATH": MASK,
        "--images FOLDER": "pictures for a source of matches, by name; with times and ground truth",
        "--camera FILE": f"{CAMERA}; 'auto' takes the focal length from the metadata, or estimates it (default: "
        f"{camera})",
        "--readout MS": "readout of a rolling shutter in milliseconds, 0 for a global shutter; 25,up or 25,left where "
        "rows or columns are read in another direction than down; 'auto' estimates it (default: that of the "
        "calibration)",
        **TOPICS,
    }
    add_options(parser.add_argument_group("frames and camera"), helps, {"--every": int, "--fps": float}, every=1)


def with_topics(arguments: argparse.Namespace, source: str) -> str:
    """Add the chosen topics to the name of a source, where it is a ROS bag.

    * Returns: The same name where no topic is chosen, or where this is no bag.
    """
    if arguments.topic is None and arguments.truth_topic is None:
        return source
    from slam_init.datasets import detect_kind
    from slam_init.datasets.ros.source import BagName

    try:
        if not detect_kind(source).startswith("ros"):
            return source
    except SourceError:  # reported when it is opened; for slam-init compare it may be a folder of sequences
        return source
    return str(BagName(source, arguments.topic, arguments.truth_topic))


def with_gravity(arguments: argparse.Namespace, source: TimedSource) -> TimedSource:
    """Give the frames of a source the gravity that is asked for."""
    if arguments.gravity is None:
        return source
    from slam_init.datasets.inertial import inertial_of
    from slam_init.datasets.track_source import TrackProvider
    from slam_init.datasets.views import GravitySource, at_rest, read_gravity

    if isinstance(source, TrackProvider):
        raise UsageError(f"{arguments.source} has tracks of its own: --gravity is for sources of images")
    if arguments.gravity != BY_IMU:
        known = read_gravity(arguments.gravity)
    else:
        record = arguments.sensor.record if arguments.sensor else inertial_of(source)
        if record is None:
            raise UsageError(f"--gravity imu: {source.name} has no accelerations ({SENSORS}): give --imu=FILE.csv")
        known = at_rest(record)
    return GravitySource(source, known, f"the frames have gravity from {arguments.gravity}")


def view_of(arguments: argparse.Namespace, every: int) -> SourceView:
    """Return which frames and pixels of a source the options ask for."""
    from slam_init.datasets.views import SourceView

    mask = None if arguments.mask is None else str(user_path(arguments.mask).absolute())
    return SourceView(every, arguments.fps, mask)


def calibrated_view_of(arguments: argparse.Namespace, every: int) -> SourceView:
    """Return the same with the calibration, by an absolute path: workers have folders of their own."""
    camera = arguments.camera
    if camera is not None and user_path(camera).exists():
        camera = str(user_path(camera).absolute())
    return replace(view_of(arguments, every), camera=camera)


def opened_source(arguments: argparse.Namespace, seed: int) -> TimedSource:
    """Open the source, with the chosen topics or pictures, limited to the frames and pixels that are asked for."""
    from slam_init.datasets import open_source
    from slam_init.datasets.track_source import TrackProvider, TrackSource, with_pictures

    name, view = with_topics(arguments, arguments.source), view_of(arguments, arguments.every)
    source = open_source(name, seed)
    if name == arguments.source and (arguments.topic or arguments.truth_topic):
        raise UsageError(f"--topic and --truth-topic choose those of a ROS bag, and {name} is none: leave them out")
    if arguments.images is not None:
        from slam_init.datasets.image_files import ImageFileSource

        if not isinstance(source, TrackSource):
            raise UsageError(f"--images is for a source of matches, and {arguments.source} has images: leave it out")
        pictures = open_source(arguments.images)
        if not isinstance(pictures, ImageFileSource):
            raise UsageError(f"--images is {arguments.images!r}: give a folder of images")
        source = with_pictures(source, pictures)
    if view.query and isinstance(source, TrackProvider):
        raise UsageError(f"{name} has tracks of its own: --every, --fps and --mask are for sources of images")
    return view.apply(source)


def chosen_camera(arguments: argparse.Namespace, source: Source, start: int) -> Camera:
    """Return the camera that was asked for, else that of the source, else one whose focal length is to be estimated.

    It is checked against the first image used.
    """
    from slam_init.calibration.files import AUTO, camera_of_metadata, camera_of_source, load_camera, orientation_of

    asked = arguments.camera
    if asked is None:
        camera = camera_of_source(source, start=start)
    else:
        height, width = next(source.frames(start, 1)).image.shape[:2]
        stated = camera_of_metadata(source, (width, height)) if asked in AUTO else None
        camera = stated or load_camera(asked, (width, height), orientation_of(source))
    return camera if arguments.readout is None else _with_readout(camera, arguments.readout)


def _with_readout(camera: Camera, text: str) -> Camera:
    """The camera with the readout of the command line."""
    if text == "auto":
        return replace(camera, readout_ms=None)
    milliseconds, _, direction = text.partition(",")
    try:
        return replace(camera, readout_ms=float(milliseconds), readout_direction=direction or "down")
    except ValueError:
        raise UsageError(f"--readout is {text!r}: give milliseconds, as in 25 or 25,up, or auto") from None
