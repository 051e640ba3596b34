"""Comparison of estimated trajectories with the ground truth."""
