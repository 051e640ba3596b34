"""Relative camera pose from matched bearings, by quaternions (QuEst).

One convention for the whole package: two views of a scene obey ::

    u R m + t = v n

with m, n the rays of one point in camera 1 and camera 2, u, v its depths along them, ``R, t = cam2_from_cam1``.
"""
