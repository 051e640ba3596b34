"""What can be wrong with the caller or the data, as opposed to the scene.

A scene that does not allow initialization is not an error: it is a :class:`slam_init.types.result.Result` with a
``reason``. The classes here mean that somebody has to change an argument or a file, and their message is one line
that names what is wrong and what to do about it. The command line prints that line and exits with code 2.
"""

from __future__ import annotations

__all__ = ["CalibrationError", "ConfigError", "OutputError", "SlamInitError", "SourceError"]


class SlamInitError(Exception):
    """Base of everything that this package raises on purpose. The message is one line for a person."""


class SourceError(SlamInitError):
    """A video, folder or image cannot be read as asked."""


class CalibrationError(SlamInitError):
    """A camera calibration is missing, unreadable or impossible."""


class ConfigError(SlamInitError):
    """A configuration file or option holds something unknown or out of range."""


class OutputError(SlamInitError):
    """Results cannot be written where the caller asked for them."""
