"""The joint estimate of a window: hypotheses, one robust fit of all views for each, and the risk of the best one.

* :mod:`slam_init.window.tracks` chooses the tracks;
* :mod:`slam_init.window.live` carries the hypotheses from frame to frame, each with its points;
* :mod:`slam_init.window.hypotheses` fits each :mod:`slam_init.window.motion` to all views, beside a rotation-only
  camera: :mod:`slam_init.window.locating` finds the poses of views that a motion does not know, and
  :mod:`slam_init.window.planarity` decides whether the points lie on a plane;
* :mod:`slam_init.window.state` holds the unknowns of a fit, :mod:`slam_init.window.equations` their equations (compiled
  in :mod:`slam_init.window.kernel`, :mod:`slam_init.window.elimination` and :mod:`slam_init.lenses.point`);
* :mod:`slam_init.window.joint_fit` fits poses, points, plane and focal length;
* :mod:`slam_init.window.linearization` expands the cost of a fit, and integrates out the smooth errors that the tracks
  of a view share;
* :mod:`slam_init.window.uncertainty` states the covariance of rotation, direction and distances;
* :mod:`slam_init.window.risk` composes the probability that a map of the best hypothesis is wrong:
  :mod:`slam_init.window.direction_term` states that of a large error, :mod:`slam_init.window.competing` lets the tracks
  vote between motions, :mod:`slam_init.window.other_motion` looks for the motion of a large object;
* :mod:`slam_init.window.rotation_term` states that of a camera that only rotates, also with zooms
  (:mod:`slam_init.window.zooming_rotation`) where all other terms are small;
* :mod:`slam_init.window.levels` holds the numbers.

:mod:`slam_init.decision.window_rule` decides by this number.
"""
