"""From photographs to a block folder: what joins the measuring of images with orientations and with files of blocks.

It lies above `imagery`, which knows no orientation of pairs, above `approximate`, which knows no image, and above `io`.

    what                                                        file
    photographs of one measurement, checked together            photo_set
    pairs verified by their relative orientation                verify
    rays of tracks by least-squares matching                    measured_rays
    the block folder                                            measured_folder
    all of it, photographs in, block folder out                 measurement
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
