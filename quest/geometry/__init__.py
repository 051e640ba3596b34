"""Rotations, epipolar geometry, homographies, refinement of a pose on its inliers."""
