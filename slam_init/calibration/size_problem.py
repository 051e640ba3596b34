"""What to do about images of another size than their calibration, or than other images: the sizes tell the cause."""

from __future__ import annotations

#: What makes an image of an EXIF orientation upright.
TURNS = {
    2: "mirrored",
    3: "turned by 180 degrees",
    4: "turned by 180 degrees and mirrored",
    5: "turned by 90 degrees and mirrored",
    6: "turned by 90 degrees clockwise",
    7: "turned by 90 degrees and mirrored",
    8: "turned by 90 degrees anticlockwise",
}
_QUARTER_TURNS = (5, 6, 7, 8)


def size_remedy(size: tuple[int, ...], expected: tuple[int, int], orientation: int, otherwise: str) -> str:
    """Name the cause of an unexpected size, and the remedy.

    * ``size, expected``: Width and height.
    * ``orientation``: That of EXIF, 1 for an upright image.
    * ``otherwise``: The remedy where the sizes tell no cause.
    """
    width, height = expected
    if size == (height, width):
        if orientation in _QUARTER_TURNS:
            turn = f"by its EXIF orientation, which is not applied, the image is to be {TURNS[orientation]}"
            return f"{turn}: store it so (mogrify -auto-orient), or give the calibration of the images as stored"
        return "one of both is turned by 90 degrees: turn the images, or calibrate them as they are"
    for doubled, places, crop in (
        ((2 * width, height), "side by side", "iw/2:ih:0:0"),
        ((width, 2 * height), "one above the other", "iw:ih/2:0:0"),
    ):
        if size == doubled:
            return f"the image holds two pictures {places}: cut one out (ffmpeg -i IN -vf crop={crop} OUT)"
    return otherwise
