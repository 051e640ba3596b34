"""The size of the patches of tracks, and of what an alignment finds."""

#: Side of a patch, as the window of the flow has it by default.
SIDE_PX = 21
#: A line of a patch, with a pixel beyond each end, is filled up to this: a processor works on eight numbers at once.
#: That the compiler knows the length halves the time of an alignment.
WIDE = 24
#: Unknowns of an alignment: the displacement, the affine map (row by row, as displacements at the border of the patch),
#: and the mean and the contrast of the image.
UNKNOWNS = 8
