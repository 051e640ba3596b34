"""Lens models: how the rays of a camera become places in the image, and back.

Two of them are formulas on the plane z = 1, which ends at 90 degrees (:mod:`~slam_init.types.lenses.planar`). All
others are a :class:`~slam_init.types.lenses.lens.Lens`: a profile, which maps rays of any angle to lens coordinates
(u, v), and a distortion of these coordinates. The pixel is ``(fx u' + cx, fy v' + cy)`` with the distorted coordinates
(u', v'). :mod:`~slam_init.types.lenses.models` has the names and coefficients of the models, and the lens of each.
"""
