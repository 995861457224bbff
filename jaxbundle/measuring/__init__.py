"""From photographs to a block folder: what joins the measuring of images with orientations and with files of blocks.

It lies above `imagery`, which knows no orientation of pairs, above `approximate`, which knows no image, and above `io`.

    what                                                        file
    photographs of one measurement, checked together            photo_set
    pairs verified by their relative orientation                verify
    rays of tracks by least-squares matching                    rays
    the block folder                                            folder
    all of it, photographs in, block folder out                 measure
"""

from jaxbundle.measuring.measure import CameraGiven, Measured, MeasureOptions, measure
from jaxbundle.measuring.photo_set import read_positions

__all__ = ["CameraGiven", "MeasureOptions", "Measured", "measure", "read_positions"]
