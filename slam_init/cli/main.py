"""The command line: ``slam-init run``, ``compare``, ``audit`` and the others of :func:`make_parser`.

Exit codes: 0 initialized (or done), 2 bad usage or input, 3 the data never allowed initialization, or an audited map is
doubtful, 4 an audited map is wrong. An interrupt gives 128 and the number of the signal:
130 for SIGINT, 143 for SIGTERM, 129 for SIGHUP.
Whatever is wrong is reported in one line on stderr.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from typing import NoReturn

import slam_init
from slam_init.cli.audit import add_audit
from slam_init.cli.calibrate import add_calibrate
from slam_init.cli.compare import add_compare
from slam_init.cli.info import add_info
from slam_init.cli.parser import BAD_INPUT, INTERRUPTED, Parser, Print
from slam_init.cli.run import add_run
from slam_init.cli.synth import add_synth
from slam_init.cli.view import add_view
from slam_init.errors import SlamInitError, plain_line
from slam_init.system.process_io import complain, fill_closed_streams, interrupts_noted, silence_native_stderr


def entry_point() -> NoReturn:
    """The console script."""
    fill_closed_streams()
    silence_native_stderr()
    os.environ.setdefault("TQDM_NROWS", "24")  # a terminal that states no size, as of script(1), would get no bar
    code = main()
    if code > INTERRUPTED:
        # Where an interrupt comes inside ``exec``, Python ends by SIGINT later, whatever the exit code.
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    * ``argv``: Arguments without the program's name; those of the process by default.
    """
    signals: list[int] = []
    try:
        with interrupts_noted(signals):
            try:
                parser = make_parser()
                if "_ARGCOMPLETE" in os.environ:  # the shell asks what may come next, and gets no other output
                    import argcomplete

                    argcomplete.autocomplete(parser)
                arguments = parser.parse_args(argv)
                if "command" not in arguments:
                    parser.error("no COMMAND: give one")
                code: int = arguments.command(arguments)
            except Exception:
                # An extension module that is interrupted while it is imported raises an ImportError instead.
                if signals:
                    raise KeyboardInterrupt from None
                raise
    except SlamInitError as error:
        complain(f"error: {error}")
        return BAD_INPUT
    except MemoryError:
        complain("error: not enough memory: give fewer or smaller images (--every, --max-frames), or close programs")
        return BAD_INPUT
    except ImportError as error:  # a broken installation; those of users are reported where they are loaded
        what = plain_line(str(error))[:300]
        complain(f"error: {what}: correct that, or install slam-init again in a new environment")
        return BAD_INPUT
    except KeyboardInterrupt as interrupt:
        complain(str(interrupt) or "interrupted")
        return INTERRUPTED + (signals[0] if signals else signal.SIGINT)
    except SystemExit as done:  # --help and --version
        return int(done.code or 0)
    return code


def make_parser() -> Parser:
    """Make the parser of all commands; the page of the command line is made from it."""
    parser = Parser(
        prog="slam-init",
        description="Monocular SLAM initialization: from a video to a bundle-adjusted map, or why not.",
        epilog="Exit codes: 0 initialized or done, 2 bad input, 3 never initialized (audit: doubtful), 4 audit: wrong, "
        "130 interrupted (128 + signal).",
        allow_abbrev=False,
    )
    version = f"slam-init {slam_init.__version__}\n"
    parser.add_argument("--version", action=Print, nargs=0, const=lambda: version, help="print the version and exit")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for add in (add_run, add_view, add_info, add_compare, add_calibrate, add_audit, add_synth):
        add(commands)
    return parser
