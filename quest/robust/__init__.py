"""Robust estimation: RANSAC, local optimization, compiled loops, rotation, plane, pose modes, correlated errors."""
