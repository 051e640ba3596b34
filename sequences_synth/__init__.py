"""Textured worlds with exact truth, seen by real feature detectors."""
