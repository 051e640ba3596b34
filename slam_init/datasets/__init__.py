"""Readers of image sequences."""
