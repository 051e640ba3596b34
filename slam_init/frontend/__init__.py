"""Features, tracks and keyframes: from images to pairs of frames."""
