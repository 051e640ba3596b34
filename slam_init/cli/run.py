"""``slam-init run``."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from importlib import import_module
from typing import TYPE_CHECKING

from slam_init.cli import parser
from slam_init.cli.parser import BY_IMU, SENSORS, UsageError
from slam_init.system.process_io import complain, emit, first_interrupt_calls
from slam_init.system.regular_file import user_path

if TYPE_CHECKING:
    from slam_init.config import Config
    from slam_init.datasets.live import LiveSource
    from slam_init.types.frame import Source

_DEFAULT_SOURCE = "synth:room"
_DEFAULT_OUT = "slam-init-out"
_TYPES = {
    "--start": parser.number(0),
    "--max-frames": parser.number(1),
    "--seed": parser.number(0),
    "--max-depth-sigma": float,
    "--min-parallax": float,
    "--refine": parser.number(0),
    "--continue": parser.number(0),
}
_DECISION = {
    "--method NAME": "way to initialize: quest (default), orb-slam3, ... (--list-methods); or an external program, as "
    "'command:PROGRAM {images} {times} {camera} {out}'",
    "--seed N": "of draws and synthetic worlds (default: 0)",
    "--config FILE": "options in TOML, as in DIR/config.toml",
    "--matcher NAME": "match images in the place of following points by flow: sift, orb, lightglue, "
    "hloc:FEATURES,MATCHER, or your own as module:attribute or file.py:attribute",
    "--refine-focal": "adjust the focal length with the map",
    "--imu [FILE]": "use the gyroscope of the source (EuRoC, ROS bags): --imu behind SOURCE; or that of a file with "
    "t,gx,gy,gz,ax,ay,az and its T_cam_imu in a YAML file of the same name: --imu=FILE.csv",
    "--gravity FILE": "direction of gravity in the frames: a table of TIME x y z or NAME x y z; or imu: by the "
    "accelerations of the source or of --imu=FILE, where they rest",
    "--max-depth-sigma S": "wait until three quarters of the landmarks have depths known to this share of themselves, "
    "0.002 to 0.2 (default: 0.2), by the noise of single tracks; the depths that are printed hold all errors",
    "--min-parallax DEG": "wait until the landmarks have this median parallax (default: no bound)",
}
_AFTER = {
    "--refine N": "let the map grow by the next N frames before it is exported: keyframes, landmarks, better depths",
    "--continue N": "then locate the next N frames in the map; with --restart: read N frames after the first map",
    "--restart": "follow the frames after the map, restart where it is lost: a map a segment, frame numbers of SOURCE",
    "--scale HOW": "metres by a known length: marker:tag36h11:0.14, board:9x6:0.025, height:1.65[,nadir], "
    "distance:0.25[,I,J] or groundtruth; a length may have a deviation, as in 1.65+-0.02; or imu: accelerations of the "
    "source or of --imu=FILE",
    "--export FORMATS": "also write the map for other tools: scene (images, COLMAP model and transforms.json for "
    "COLMAP, nerfstudio, 3DGS)",
}
_LIVE = {
    "--no-drop": "of a live source: let the sender wait, drop no frame",
    "--live [URL]": "show the run in a Rerun viewer while it goes on: --live behind SOURCE starts one, "
    "--live=rerun+http://HOST:9876/proxy uses one that runs",
}
_RESULTS = {
    "--out DIR": parser.OUT_HELP,
    "--no-overview": "do not draw DIR/overview.png",
    "--json": "print the summary as JSON and nothing else",
    "--quiet": "print nothing but errors (and --json)",
}


def add_run(commands: parser.Commands) -> None:
    """Add the command."""
    description = "Read frames until a map is found; write it, and a recording of how, to a folder."
    run = parser.add_command(commands, "run", _run, "initialize from a sequence", description)
    parser.add_source(run, default=_DEFAULT_SOURCE)
    frames = {"--start K": "skip the first K frames", "--max-frames N": "give up after N frames"}
    parser.add_options(run.add_argument_group("first and last frame"), frames, _TYPES, start=0)
    decision = run.add_argument_group("how it decides")
    parser.add_options(decision, _DECISION, _TYPES)
    parser.add_list_methods(decision)
    parser.add_options(run.add_argument_group("after the map"), _AFTER, _TYPES)
    parser.add_options(run.add_argument_group("live sources, and a viewer"), _LIVE)
    parser.add_options(run.add_argument_group("results"), _RESULTS, out=_DEFAULT_OUT)


def _run(arguments: argparse.Namespace) -> int:
    """``slam-init run``."""
    from slam_init.output.folder import chosen_folder
    from slam_init.scale.requests import parse_scale

    arguments.continue_frames = vars(arguments)["continue"]  # a word of the language
    arguments.export = arguments.export.split(",") if arguments.export is not None else ()
    arguments.scale = None if arguments.scale is None else parse_scale(arguments.scale)
    arguments.config = None if arguments.config is None else user_path(arguments.config)
    read = (arguments.images, arguments.camera, arguments.mask, arguments.imu, arguments.config, arguments.gravity)
    inputs = [arguments.source, *(file for file in read if file not in (None, True, BY_IMU))]
    out = chosen_folder(arguments.out, "run", inputs)

    from slam_init.datasets.live import LiveSource, is_live, without_password

    if not arguments.quiet and sys.stderr.isatty():  # the libraries take seconds to load, before there is a bar
        complain(f"reading {without_password(arguments.source)}")
    from slam_init.output.plain_json import json_text
    from slam_init.output.report import earlier_result, report_text

    config, live = _config(arguments), is_live(arguments.source)
    _check_method(arguments, config.method)
    if not live and arguments.no_drop:
        raise UsageError("--no-drop is for live sources: leave it out")
    replaced = earlier_result(out)
    arguments.sensor = None
    if isinstance(arguments.imu, str):
        from slam_init.datasets.inertial import read_inertial_file

        arguments.sensor = read_inertial_file(arguments.imu)
    if arguments.live is not None:
        from slam_init.recording.viewer import SPAWN, viewer_url

        arguments.live = viewer_url(SPAWN if arguments.live is True else arguments.live)
    with ExitStack() as opened:
        source: Source
        if live:
            source = opened.enter_context(_stream(arguments))
        else:
            source = parser.with_gravity(arguments, parser.opened_source(arguments, config.seed))
        camera = parser.chosen_camera(arguments, source, arguments.start)
        _check_source(arguments, source)
        from slam_init.runner import run

        if isinstance(source, LiveSource):
            # An interrupt ends it as if its data had ended, and the next one ends the program.
            opened.enter_context(first_interrupt_calls(source.stop))
        result, summary = run(
            source,
            camera,
            config,
            out=out,
            start=arguments.start,
            max_frames=arguments.max_frames,
            continue_frames=arguments.continue_frames,
            progress=not arguments.quiet and sys.stderr.isatty(),
            overview=not arguments.no_overview,
            viewer=arguments.live,
            scale=arguments.scale,
            restart=arguments.restart,
            imu=arguments.sensor or bool(arguments.imu),
            export=arguments.export,
        )
    if arguments.json:
        emit(json_text(summary))
    elif not arguments.quiet:
        emit(report_text(result, summary, out, replaced))
    return parser.DONE if summary.reason is None else parser.NOT_INITIALIZED


def _config(arguments: argparse.Namespace) -> Config:
    """The configuration of the file, with the values that the command line gives."""
    from slam_init.config import load_config

    overrides = {
        "method": arguments.method,
        "seed": arguments.seed,
        "refine_frames": arguments.refine,
        "acceptance.max_depth_sigma": arguments.max_depth_sigma,
        "acceptance.min_parallax_deg": arguments.min_parallax,
        "map.refine_focal": arguments.refine_focal or None,
        "tracking.matcher": arguments.matcher,
    }
    return load_config(arguments.config, overrides)


def _check_method(arguments: argparse.Namespace, method: str) -> None:
    """Refuse an unknown method, and options that would have no effect with it."""
    from slam_init.methods.external_command import is_external
    from slam_init.methods.registry import method_info

    external = is_external(method)
    has_window = not method_info(method).home and not external
    if arguments.refine and not has_window:
        raise UsageError(f"--refine goes on with the window, which {method} has not: use --continue")
    if external and arguments.continue_frames:
        raise UsageError("--continue needs landmarks, which an external program does not give: leave --continue out")
    if external and arguments.matcher is not None:
        raise UsageError("--matcher gives tracks, which an external program does not take: leave --matcher out")
    if external and arguments.gravity is not None:
        raise UsageError("--gravity is stated by a map of our own, which an external program does not make")


def _stream(arguments: argparse.Namespace) -> LiveSource:
    """Open a stream, after what takes time, so that no frame waits for it."""
    from slam_init.datasets.live import open_live
    from slam_init.initializer import load_all

    stored = {"every": 1, "fps": None, "mask": None, "gravity": None, "images": None}
    parser.refuse_changed(arguments, stored, "a live source is not read from files, and takes no")
    source = open_live(arguments.source, keep_all=arguments.no_drop)
    import_module("slam_init.recording.rerun_recorder")
    load_all()
    return source


def _check_source(arguments: argparse.Namespace, source: Source) -> None:
    """Refuse options that ask for what a source does not have."""
    from slam_init.datasets.inertial import gyroscope_of, inertial_of
    from slam_init.datasets.track_source import TrackProvider
    from slam_init.scale.requests import MeasuredMotion, TrueTrajectory

    sensor = arguments.sensor
    if arguments.imu is True and gyroscope_of(source) is None:
        raise UsageError(f"--imu: {source.name} has no gyroscope ({SENSORS}): leave --imu out, or give --imu=FILE.csv")
    if isinstance(arguments.scale, MeasuredMotion) and (sensor.record if sensor else inertial_of(source)) is None:
        if sensor is not None:
            raise UsageError(f"--scale imu: {arguments.imu} has no accelerations: its columns are t,gx,gy,gz,ax,ay,az")
        raise UsageError(f"--scale imu: {source.name} has no accelerations ({SENSORS}): give --imu=FILE.csv")
    if isinstance(arguments.scale, TrueTrajectory) and source.groundtruth is None:
        raise UsageError(f"--scale groundtruth: {source.name} has no true trajectory: leave --scale out")
    if isinstance(source, TrackProvider) and arguments.matcher is not None:
        raise UsageError(f"--matcher matches images, and {source.name} has tracks of its own: leave it out")
