"""Exceptions for errors of the caller or of the data.

A scene that does not allow initialization is not an error: the result is then a
:class:`slam_init.types.result.Result` with a ``reason``. An exception of this module means that the user has to change
an argument or a file. Its message is one line that names the error and the remedy. The command line prints this line
and exits with code 2.
"""

from __future__ import annotations

__all__ = ["CalibrationError", "ConfigError", "OutputError", "SlamInitError", "SourceError"]


class SlamInitError(Exception):
    """Base of all exceptions of this package. The message is one line for the user."""


class SourceError(SlamInitError):
    """A video, folder or image cannot be read."""


class CalibrationError(SlamInitError):
    """A camera calibration is missing, unreadable or impossible."""


class ConfigError(SlamInitError):
    """A configuration file or option has an unknown name, or a value that is out of range."""


class OutputError(SlamInitError):
    """Results cannot be written to the requested place."""
