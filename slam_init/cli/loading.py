"""The libraries of a run, loaded at once."""

from __future__ import annotations

import gc
from contextlib import suppress


def load_libraries(*, pictures: bool) -> None:
    """Load what a run needs: the recorder, the decision with its compiled loops, and what draws the overview.

    The collector of garbage rests meanwhile, and leaves the modules alone afterwards: it would look through all of them
    several times, a tenth of the time of a short run. A thread beside the first frame was slower, since both wait for
    the interpreter.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        with suppress(ImportError):  # the run tells what is missing, where it needs it
            _load(pictures)
    finally:
        gc.freeze()
        if collecting:
            gc.enable()


def _load(pictures: bool) -> None:
    from slam_init.recording.layout import blueprint
    from slam_init.recording.rerun_recorder import load_rerun

    load_rerun()
    blueprint()
    import slam_init.decision.window_rule
    import slam_init.runner  # noqa: F401

    if pictures:
        from slam_init.pictures.overview import canvas

        with canvas(1, 1):
            pass
