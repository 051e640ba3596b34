"""Options and output that the programs share."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path


def positive(text: str) -> int:
    """Parse an integer that is at least 1, for argparse."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer that is at least 1")
    return value


def show(text: str, out: str | os.PathLike[str] | None) -> None:
    """Print a text, and also write it to a file if one is given."""
    sys.stdout.write(text)
    if out is not None:
        Path(out).write_text(text, encoding="utf-8")
