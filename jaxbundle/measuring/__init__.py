"""From photographs to a block folder: combines measurement of images, orientations and block files.

It uses `imagery`,

which has no orientation of pairs, `approximate`, which has no images, and `io`.

    what                                                        file
    photographs of one measurement, checked together            photo_set
    stations, in the system of the control                      stations
    pairs verified by their relative orientation, in files      verify, pair_files
    rays of tracks by least-squares matching                    measured_rays
    marks of control points, remeasured                         control_marks
    the block folder                                            measured_folder
    the whole process, from photographs to block folder                 measurement
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
