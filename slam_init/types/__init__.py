"""The types of the pipeline: poses, cameras, frames, maps, attempts, results, reasons.

Conventions, stated once for the whole project:

* A pose named ``a_from_b`` maps coordinates of frame b to frame a: ``X_a = R X_b + t``. Names cancel when poses are
  composed: ``a_from_c = a_from_b @ b_from_c``.
* Camera frames are optical: x right, y down, z forward.
* Quaternions are Hamilton, ordered ``wxyz``, with ``w >= 0``. Only files in TUM format have the order ``xyzw``.
* Two views obey ``u R m + t = v n`` (see :mod:`quest`) with ``R, t = cam2_from_cam1``.
* Pixel centres lie at integer coordinates. Units are suffixes: ``_px``, ``_deg``, ``_rad``, ``_s``, ``_ms``.
"""
