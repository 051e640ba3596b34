"""Monocular SLAM initialization: from a video to a bundle-adjusted map, on planes too, or a reason why not."""
