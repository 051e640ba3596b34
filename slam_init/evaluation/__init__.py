"""Comparison of estimates with ground truth."""
