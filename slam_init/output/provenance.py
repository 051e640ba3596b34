"""The provenance of a result: versions, command line, options, a hash of the input."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from slam_init.output.plain_json import Json
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.inertial import InertialRecord


@dataclass(frozen=True)
class Provenance:
    """The versions, options and input of a run."""

    #: Versions of Python and of the packages that a result depends on.
    packages: Mapping[str, str]
    #: The command line.
    command: tuple[str, ...]
    #: The resolved configuration and the options of the run.
    options: Mapping[str, Json]
    #: Hash of the calibration and of the frames that were read: pixels, names, time stamps and measured rotations, in
    #: order. Empty where another program read them.
    input_blake2b: str


#: The versions of these packages may change a result.
_PACKAGES = ("slam-init", "numpy", "scipy", "opencv-python-headless", "gtsam", "rerun-sdk", "numba")
NOT_INSTALLED = "not installed"


class InputHash:
    """Hash of the frames of a run. Equal pixels, masks, names, time stamps and calibrations have equal hashes.

    * ``camera``: The stated calibration.
    """

    def __init__(self, camera: Camera) -> None:
        self._hash = hashlib.blake2b(repr(camera).encode(), digest_size=16)

    def reading(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Pass frames through, and add them to the hash."""
        for frame in frames:
            header = f"{frame.index} {frame.timestamp_s!r} {frame.name} {frame.image.shape}"
            self._hash.update(header.encode("utf-8", "surrogateescape"))
            self._hash.update(np.ascontiguousarray(frame.image).data)
            if frame.mask is not None:
                self._hash.update(np.ascontiguousarray(frame.mask).data)
            if frame.gravity is not None:
                self._hash.update(np.append(frame.gravity.down, frame.gravity.sigma_deg).data)
            yield frame

    def observed(self, observations: Observations) -> None:
        """Add given tracks to the hash."""
        self._hash.update(np.ascontiguousarray(observations.track_ids).data)
        self._hash.update(np.ascontiguousarray(observations.pixels).data)

    def turned(self, rotation: Floats, sigma_rad: float) -> None:
        """Add a measured rotation to the hash: ``rotation`` (3, 3)."""
        self._hash.update(np.ascontiguousarray(rotation).data)
        self._hash.update(repr(sigma_rad).encode())

    def inertial(self, record: InertialRecord) -> None:
        """Add the record of an inertial sensor to the hash."""
        for one in (record.timestamps_s, record.rates_rad_s, record.accelerations_m_s2, record.cam_from_imu.matrix()):
            self._hash.update(np.ascontiguousarray(one, float).data)

    def hexdigest(self) -> str:
        """Return the hash of the frames that were read up to now."""
        return self._hash.hexdigest()


def provenance_of(
    command: Sequence[str], options: Mapping[str, Json], input_hash: InputHash | None = None
) -> Provenance:
    """Gather the provenance of a run, or of a result without the hash of its input."""
    hashed = "" if input_hash is None else input_hash.hexdigest()
    return Provenance(package_versions(_PACKAGES), tuple(command), dict(options), hashed)


def package_versions(names: Sequence[str]) -> dict[str, str]:
    """Return the versions of Python and of packages."""
    packages = {"python": platform.python_version()}
    for name in names:
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            packages[name] = NOT_INSTALLED
    return packages
