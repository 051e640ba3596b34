"""The distortion of lens coordinates: a ratio of radial polynomials, tangential terms and thin prism terms.

With ``s = u^2 + v^2`` ::

    u' = u N(s) / D(s) + 2 p1 u v + p2 (s + 2 u^2) + s1 s + s2 s^2
    v' = v N(s) / D(s) + p1 (s + 2 v^2) + 2 p2 u v + s3 s + s4 s^2
    N = 1 + n1 s + n2 s^2 + n3 s^3 + n4 s^4        D = 1 + d1 s + d2 s^2 + d3 s^3

This is OpenCV's model with 12 coefficients (n4 = 0), and the model of COLMAP's THIN_PRISM_FISHEYE (d = 0, s2 = s4 = 0).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam_init.types.arrays import Floats

# Newton's method in one unknown, safeguarded by bisection: 60 halvings reach the precision of a float.
_RADIUS_STEPS = 60
# A step of Newton's method that is this small, over one plus the largest radius, was the last: the next one is its
# square.
_SETTLED = 1e-13
# Newton's method in two unknowns, from the radial solution: tangential and prism terms are small.
_NEWTON_STEPS = 20
# Largest distance of a place from the centre, over that of the border of the field without these terms.
_REACH = 1.1


class Bending(NamedTuple):
    """The coefficients of the distortion; see the module docstring."""

    #: n1, n2, n3, n4: Of the numerator.
    n1: float = 0.0
    n2: float = 0.0
    n3: float = 0.0
    n4: float = 0.0
    #: d1, d2, d3: Of the denominator.
    d1: float = 0.0
    d2: float = 0.0
    d3: float = 0.0
    #: p1, p2: Tangential.
    p1: float = 0.0
    p2: float = 0.0
    #: s1, s2, s3, s4: Of the thin prism.
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0

    def radial(self, radius: Floats) -> tuple[Floats, Floats, Floats]:
        """Compute the distorted radius by the radial terms alone.

        Shapes: ``radius`` (N,), returns ``distorted`` (N,), returns ``slope`` (N,), returns ``denominator`` (N,).
        """
        s = radius * radius
        ratio, change, denominator = self._ratio(s)
        return radius * ratio, ratio + 2 * s * change, denominator

    def apply(self, uv: Floats) -> Floats:
        """Distort lens coordinates.

        Shapes: ``uv`` (N, 2), returns (N, 2).
        """
        if self == STRAIGHT:
            return uv
        u, v = uv[:, 0], uv[:, 1]
        s = u * u + v * v
        ratio, _, _ = self._ratio(s)
        return np.column_stack(
            [
                u * ratio + 2 * self.p1 * u * v + self.p2 * (s + 2 * u * u) + s * (self.s1 + s * self.s2),
                v * ratio + self.p1 * (s + 2 * v * v) + 2 * self.p2 * u * v + s * (self.s3 + s * self.s4),
            ]
        )

    def jacobian(self, uv: Floats) -> Floats:
        """Differentiate :meth:`apply`.

        Shapes: ``uv`` (N, 2), returns (N, 2, 2).
        """
        u, v = uv[:, 0], uv[:, 1]
        s = u * u + v * v
        ratio, change, _ = self._ratio(s)
        across = 2 * u * v * change + 2 * self.p1 * u + 2 * self.p2 * v
        prism_u, prism_v = 2 * (self.s1 + 2 * self.s2 * s), 2 * (self.s3 + 2 * self.s4 * s)
        J = np.empty((len(uv), 2, 2))
        J[:, 0, 0] = ratio + 2 * u * u * change + 2 * self.p1 * v + 6 * self.p2 * u + prism_u * u
        J[:, 0, 1] = across + prism_u * v
        J[:, 1, 0] = across + prism_v * u
        J[:, 1, 1] = ratio + 2 * v * v * change + 6 * self.p1 * v + 2 * self.p2 * u + prism_v * v
        return J

    def least_growth(self, radius: Floats, directions: int) -> Floats:
        """Compute by how much a small step of the coordinates moves the distorted ones at least.

        Shapes: ``radius`` (N,), returns (N,).

        * ``directions``: Number of directions that are tried, where the distortion is not symmetric about the axis.
        * Returns: Smallest eigenvalue of the symmetric part of the Jacobian; negative where D is not positive.
        """
        if not any(self[7:]):
            ratio, change, denominator = self._ratio(radius * radius)
            least = np.minimum(ratio, ratio + 2 * radius * radius * change)
        else:
            angles = 2 * np.pi / directions * np.arange(directions)
            uv = (radius[:, None, None] * np.column_stack([np.cos(angles), np.sin(angles)])).reshape(-1, 2)
            J = self.jacobian(uv)
            middle, half = 0.5 * (J[:, 0, 0] + J[:, 1, 1]), 0.5 * (J[:, 0, 0] - J[:, 1, 1])
            eigenvalues = middle - np.hypot(half, 0.5 * (J[:, 0, 1] + J[:, 1, 0]))
            least = eigenvalues.reshape(-1, directions).min(axis=1)
            _, _, denominator = self._ratio(radius * radius)
        return np.asarray(np.where(denominator > 0, least, -1.0))

    def invert(self, distorted: Floats, largest: float) -> Floats:
        """Invert :meth:`apply`: first its radial terms, then all terms by Newton's method.

        Shapes: ``distorted`` (N, 2), returns (N, 2).
        """
        if self == STRAIGHT:
            return distorted
        uv = distorted
        if any(self[:7]):
            target = np.hypot(distorted[:, 0], distorted[:, 1])
            radius = self._radius(target, largest)
            uv = distorted * np.where(target > 0, radius / np.where(target > 0, target, 1.0), 1.0)[:, None]
        if any(self[7:]):
            # Tangential and prism terms move a place by less than a tenth. Farther out there is no ray.
            reach = _REACH * float(self.radial(np.array([largest]))[0][0])
            uv = np.where((np.hypot(distorted[:, 0], distorted[:, 1]) <= reach)[:, None], uv, np.nan)
            with np.errstate(all="ignore"):  # points without a ray may diverge
                for _ in range(_NEWTON_STEPS):
                    J, residual = self.jacobian(uv), self.apply(uv) - distorted
                    determinant = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
                    step_u = (J[:, 1, 1] * residual[:, 0] - J[:, 0, 1] * residual[:, 1]) / determinant
                    step_v = (J[:, 0, 0] * residual[:, 1] - J[:, 1, 0] * residual[:, 0]) / determinant
                    uv = uv - np.column_stack([step_u, step_v])
                    if not (np.abs(step_u) + np.abs(step_v) > _SETTLED * (1 + largest)).any():
                        break
        return np.asarray(uv)

    def _ratio(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """N / D, its derivative by s, and D."""
        n1, n2, n3, n4, d1, d2, d3 = self[:7]
        N, D = 1 + s * (n1 + s * (n2 + s * (n3 + s * n4))), 1 + s * (d1 + s * (d2 + s * d3))
        N_s, D_s = n1 + s * (2 * n2 + s * (3 * n3 + s * 4 * n4)), d1 + s * (2 * d2 + s * 3 * d3)
        with np.errstate(all="ignore"):  # beyond the field
            return np.asarray(N / D), np.asarray((N_s * D - N * D_s) / (D * D)), np.asarray(D)

    def _radius(self, target: Floats, largest: float) -> Floats:
        """Radii whose distorted radii are given; the largest one where it is not reached."""
        # A radius that is not reached would be searched by bisection to the end.
        target = np.minimum(target, self.radial(np.array([largest]))[0])
        low, high = np.zeros_like(target), np.full_like(target, largest)
        radius = np.minimum(target, largest)
        for _ in range(_RADIUS_STEPS):
            value, slope, _ = self.radial(radius)
            above = value > target
            high, low = np.where(above, radius, high), np.where(above, low, radius)
            with np.errstate(all="ignore"):  # a slope of zero
                moved = radius - (value - target) / slope
            moved = np.where((moved >= low) & (moved <= high), moved, 0.5 * (low + high))
            settled = np.abs(moved - radius) <= _SETTLED * (1 + largest)
            radius = moved
            if settled.all():
                break
        return np.asarray(radius)


#: No distortion.
STRAIGHT = Bending()
