"""Features, tracks and keyframes: the stages from images to pairs of frames."""
