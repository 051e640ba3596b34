"""Robust estimation: RANSAC, local optimization, compiled kernels, rotation, plane, pose modes."""
