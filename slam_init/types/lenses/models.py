"""The camera models by name: their coefficients, and the lens of each.

======================  ============================================  =============================================
name                    coefficients                                  in other formats
======================  ============================================  =============================================
``pinhole``             none
``radtan``              k1 k2 p1 p2 [k3]                              OpenCV, Kalibr radtan, COLMAP OPENCV
``rational``            k1 k2 p1 p2 k3 k4 k5 k6                       OpenCV, ROS rational_polynomial, FULL_OPENCV
``thin-prism``          k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4           OpenCV with 12 coefficients
``fisheye``             k1 k2 k3 k4                                   Kannala-Brandt: OpenCV fisheye, equidistant, kb4
``thin-prism-fisheye``  k1 k2 p1 p2 k3 k4 s1 s2                       COLMAP THIN_PRISM_FISHEYE
``fov``                 w [b]                                         Devernay and Faugeras: ATAN, COLMAP FOV
``omni``                xi [k1 k2 p1 p2]                              Mei: Kalibr omni, Basalt ucm
``double-sphere``       xi alpha [b]                                  Kalibr and Basalt ds
``eucm``                alpha beta [b]                                Kalibr and Basalt eucm
``equirectangular``     none                                          panorama of longitudes and latitudes
======================  ============================================  =============================================

``b`` is no part of these models. It is the radial distortion of the lens coordinates that a calibration may lack:
``(u, v) (1 + b (u^2 + v^2))``.
"""

from __future__ import annotations

import math
from functools import lru_cache

from slam_init.errors import CalibrationError
from slam_init.types.lenses.lens import STRAIGHT, Bending, Lens, Profile

#: The names of the coefficients of each model; those after a bar may be absent, all or none of them.
COEFFICIENTS: dict[str, str] = {
    "pinhole": "",
    "radtan": "k1 k2 p1 p2 | k3",
    "fisheye": "k1 k2 k3 k4",
    "rational": "k1 k2 p1 p2 k3 k4 k5 k6",
    "thin-prism": "k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4",
    "thin-prism-fisheye": "k1 k2 p1 p2 k3 k4 s1 s2",
    "fov": "w | b",
    "omni": "xi | k1 k2 p1 p2",
    "double-sphere": "xi alpha | b",
    "eucm": "alpha beta | b",
    "equirectangular": "",
}

#: Position of the coefficient to which more radial distortion is added; models without one are not bent.
_FIRST_RADIAL = {
    "radtan": 0, "fisheye": 0, "rational": 0, "thin-prism": 0, "thin-prism-fisheye": 0,
    "fov": 1, "omni": 1, "double-sphere": 2, "eucm": 2,
}  # fmt: skip

#: The degrees of the terms of the coefficients of perspective models, less one.
_DEGREES = {"k1": 2, "k2": 4, "p1": 1, "p2": 1, "k3": 6, "k4": 2, "k5": 4, "k6": 6, "s1": 1, "s2": 3, "s3": 1, "s4": 3}


def _sizes(model: str) -> tuple[int, ...]:
    needed, _, more = COEFFICIENTS[model].partition("|")
    sizes = len(needed.split()), len(needed.split()) + len(more.split())
    return sizes if more else sizes[:1]


def check_coefficients(model: str, coefficients: tuple[float, ...]) -> None:
    """Refuse coefficients that a model does not take."""
    if len(coefficients) not in _sizes(model):
        allowed = " or ".join(str(n) for n in _sizes(model))
        order = f" ({' '.join(COEFFICIENTS[model].replace('|', ' ').split())})" if COEFFICIENTS[model] else ""
        raise CalibrationError(
            f"{len(coefficients)} distortion coefficients for a {model} camera: give {allowed}{order}"
        )
    values = dict(zip(COEFFICIENTS[model].replace("|", " ").split(), coefficients, strict=False))

    def _check(name: str, fits: bool, what: str) -> None:
        if not fits:
            raise CalibrationError(f"{name} of a {model} camera is {values[name]!r}: it must be {what}")

    if model == "fov":
        _check("w", 1e-3 <= values["w"] < math.pi, "an angle in rad above 0.001 and below pi")
    elif model == "omni":
        _check("xi", 0 <= values["xi"] <= 100, "a number from 0 to 100")
    elif model == "double-sphere":
        _check("xi", -1 < values["xi"] <= 1, "a number above -1, and at most 1")
        _check("alpha", 0 <= values["alpha"] < 1, "a number from 0 to below 1")
    elif model == "eucm":
        _check("alpha", 0 <= values["alpha"] <= 1, "a number from 0 to 1")
        _check("beta", 0 < values["beta"] <= 100, "a positive number of at most 100")


@lru_cache(maxsize=256)
def lens_of(model: str, coefficients: tuple[float, ...]) -> Lens:
    """Make the lens of a model."""
    k = coefficients
    if model == "equirectangular":
        return Lens(Profile.PANORAMA)
    if model == "fisheye":
        return Lens(Profile.EQUIDISTANT, bending=Bending(*k))
    if model == "thin-prism-fisheye":
        bending = Bending(n1=k[0], n2=k[1], n3=k[4], n4=k[5], p1=k[2], p2=k[3], s1=k[6], s3=k[7])
        return Lens(Profile.EQUIDISTANT, bending=bending)
    if model == "fov":
        return Lens(Profile.FIELD_OF_VIEW, (k[0], 0.0, 0.0), Bending(*k[1:]))
    if model == "omni":
        bending = Bending(n1=k[1], n2=k[2], p1=k[3], p2=k[4]) if len(k) == 5 else STRAIGHT
        return Lens(Profile.SPHERE, (k[0], 0.0, 1.0), bending)
    if model == "double-sphere":
        return Lens(Profile.SPHERE, (k[0], k[1], 1.0), Bending(*k[2:]))
    if model == "eucm":
        return Lens(Profile.SPHERE, (0.0, k[0], k[1]), Bending(*k[2:]))
    # OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, of which a model has the first ones.
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = (*k, *(12 - len(k)) * (0.0,))
    return Lens(Profile.SPHERE, bending=Bending(k1, k2, k3, 0.0, k4, k5, k6, p1, p2, s1, s2, s3, s4))


def bent_coefficients(model: str, coefficients: tuple[float, ...], k1: float) -> tuple[float, ...]:
    """Add radial distortion to the coefficients of a model.

    * ``k1``: Relative change of the radius of the image, at a radius of one focal length near the axis.
    * Returns: The same ones for a panorama, which is defined by its angles.
    """
    if model not in _FIRST_RADIAL:
        return coefficients
    place = _FIRST_RADIAL[model]
    values = [*coefficients, *(max(_sizes(model)) - len(coefficients)) * [0.0]]
    # radtan keeps its number of coefficients; its fifth one is no first one.
    values = values[: max(len(coefficients), place + 1)] if model != "omni" else values
    values[place] += k1 / lens_of(model, coefficients).magnification ** 2
    return tuple(values)


def scaled_coefficients(model: str, coefficients: tuple[float, ...], factor: float) -> tuple[float, ...]:
    """Convert the coefficients of a perspective model to units of a longer focal length."""
    names = COEFFICIENTS[model].replace("|", " ").split()
    return tuple(k * factor ** _DEGREES[name] for name, k in zip(names, coefficients, strict=False))
