"""``slam-init view``."""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path

from slam_init.cli.parser import DONE, Commands, UsageError, add_command, add_options, number
from slam_init.errors import OutputError, SourceError, ViewerError
from slam_init.system.process_io import emit
from slam_init.system.regular_file import check_inside, open_regular, user_path

_DEFAULT_DIR = "slam-init-out"
_DEFAULT_PNG = "slam-init-view.png"
_DEFAULT_SIZE = "1280x720"
_PNG = b"\x89PNG\r\n\x1a\n"
#: Sides of a window in pixels: smaller ones show no view, and graphics drivers refuse larger ones.
_SMALLEST, _LARGEST = 320, 8192
#: More screenshots than this are a mistake.
_MOST_FRAMES = 100


def add_view(commands: Commands) -> None:
    """Add the command."""
    description = "Open the recording of a run in the rerun viewer, serve it to a browser, or write screenshots."
    view = add_command(commands, "view", _view, "open the recording of a run", description)
    view.add_argument(
        "folder",
        metavar="DIR",
        nargs="?",
        default=_DEFAULT_DIR,
        help="the folder of a run, or a file .rrd (default: %(default)s)",
    )
    ways = {
        "--web": "serve it to browsers on this machine, until Ctrl+C",
        "--screenshot [FILE]": f"write a PNG without a display (default: {_DEFAULT_PNG})",
    }
    add_options(view.add_mutually_exclusive_group(), ways)
    further = {
        "--port N": "of --web (default: 9090)",
        "--at FRAMES": "of --screenshot: frames as in 3,9; one file each (default: last)",
        "--size WxH": f"of --screenshot, in pixels (default: {_DEFAULT_SIZE})",
    }
    add_options(view, further, {"--port": number(1, most=65535), "--at": _frames, "--size": _size})


def _view(arguments: argparse.Namespace) -> int:
    """``slam-init view``."""
    if arguments.screenshot is None and (arguments.at is not None or arguments.size is not None):
        raise UsageError("--at and --size belong to --screenshot")
    if arguments.port is not None and not arguments.web:
        raise UsageError("--port belongs to --web")
    recording = _recording(user_path(arguments.folder))

    from slam_init.recording.viewer import WEB_PORT, check_recording, has_display, serve, show

    check_recording(recording)
    if arguments.screenshot is not None:
        file = _DEFAULT_PNG if arguments.screenshot is True else arguments.screenshot
        _write_screenshots(recording, user_path(file), arguments.at or [-1], arguments.size or _DEFAULT_SIZE)
    elif arguments.web:
        emit("open the address that the viewer prints in a browser on this machine; Ctrl+C ends\n")
        serve(recording, arguments.port or WEB_PORT)
    elif has_display():
        show(recording)
    else:
        raise ViewerError(
            f"no display here: give --web and open the page in a browser, or --screenshot, or copy {recording} to a "
            "machine with a display and run there: rerun recording.rrd"
        )
    return DONE


def _recording(path: Path) -> Path:
    """The recording that a path names: a file, or the one of a folder."""
    from slam_init.output.names import INTERRUPTED, RECORDING

    if path.is_file():
        return path
    if not path.is_dir():
        raise SourceError(f"{path}: no such folder or recording: give the --out folder of a run, or a file .rrd")
    for name in (RECORDING, INTERRUPTED):
        if (path / name).is_file():
            check_inside(path / name, path)
            return path / name
    raise SourceError(f"{path} holds no recording: give the --out folder of slam-init run")


def _frames(text: str) -> list[int]:
    frames = sorted({int(part) for part in text.split(",") if re.fullmatch(r"\d{1,9}", part)})
    if not re.fullmatch(r"\d+(,\d+)*", text) or not 0 < len(frames) <= _MOST_FRAMES:
        raise argparse.ArgumentTypeError(f"{text!r}: give at most {_MOST_FRAMES} frames, as in 3 or 3,9")
    return frames


def _size(text: str) -> str:
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if match is None or not all(_SMALLEST <= int(side) <= _LARGEST for side in match.groups()):
        raise argparse.ArgumentTypeError(
            f"{text!r}: give WIDTHxHEIGHT, each from {_SMALLEST} to {_LARGEST}, as in 1280x720"
        )
    return text


def _write_screenshots(recording: Path, target: Path, frames: list[int], size: str) -> None:
    """Write one file, or one for each frame with its number in the name."""
    from slam_init.output.folder import writing
    from slam_init.recording.viewer import screenshots

    files = {frame: target if len(frames) == 1 else target.with_stem(f"{target.stem}-{frame:06d}") for frame in frames}
    for file in files.values():
        _check_target(file)
    for (frame, png), file in zip(screenshots(recording, frames, size).items(), files.values(), strict=True):
        with writing(file, "give another name"):
            file.write_bytes(png)
        emit(f"wrote {file} (frame {frame})\n")


def _check_target(file: Path) -> None:
    """Refuse a file that is no picture, before the viewer is started."""
    if not file.parent.is_dir():
        raise OutputError(f"{file}: there is no folder {file.parent}: make it first")
    if os.path.lexists(file):
        with open_regular(file, OutputError) as earlier:
            if earlier.read(len(_PNG)) != _PNG:
                raise OutputError(f"{file} exists and is no PNG file: give another name")
