"""Options that the programs share."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

__all__ = ["positive", "show"]


def positive(text: str) -> int:
    """A whole number from 1, for argparse."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1")
    return value


def show(text: str, out: Path | None) -> None:
    """Print the text, and write it to a file as well where one was asked for."""
    sys.stdout.write(text)
    if out is not None:
        out.write_text(text, encoding="utf-8")
