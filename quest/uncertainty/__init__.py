"""What can be said of the parallax and of the direction of the translation."""
