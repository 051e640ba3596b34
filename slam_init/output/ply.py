"""Coloured points as a PLY file: binary, little-endian; positions are float, colours are uchar."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam_init.types.arrays import Floats, Image


def coloured_points(points: Floats, colors: Image, comments: Sequence[str] = (), *, normals: bool = False) -> bytes:
    """Write a PLY file.

    Shapes: ``points`` (N, 3), ``colors`` (N, 3).

    * ``normals``: Whether each point has a normal of zeros: the loader of Gaussian splatting asks for some.
    """
    names = ["x", "y", "z", *(("nx", "ny", "nz") if normals else ())]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {line}" for line in comments),
        f"element vertex {len(points)}",
        *(f"property float {name}" for name in names),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
        "end_header\n",
    ]
    vertices = np.zeros(len(points), [("floats", "<f4", len(names)), ("rgb", "u1", 3)])
    vertices["floats"][:, :3], vertices["rgb"] = points, colors
    return "\n".join(header).encode() + vertices.tobytes()
