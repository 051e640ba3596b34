"""The scale of a map: a monocular map has none, so a known length has to come from outside.

A request says what is known (:mod:`slam_init.scale.requests`): the side of a marker or of the squares of a board, the
height of the camera above the ground, a distance that the camera moved, or the true trajectory.
:func:`slam_init.scale.find.find_scale` finds the length in the map, with its standard deviation.
:func:`slam_init.scale.metric_map.in_metres` returns the map in metres.

**Standard deviations.** All lengths of a map depend on its poses, and the poses of bundle adjustment have a joint
covariance in the gauge that fixes the distance from the first camera to the one farthest from it. For given poses, the
landmarks and markers are independent of each other. By the law of total variance, a length ``h`` therefore has the
variance ``Var(h | poses) + G C G^T`` with the joint covariance C of the poses and ``G = dh / dposes``
(:mod:`slam_init.scale.sensitivity`). With little parallax the second term dominates: the cameras are known relative to
each other, and the scene is nearer or farther.
"""
