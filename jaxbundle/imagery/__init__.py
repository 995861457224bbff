"""Photographs and the rays measured in them: image pyramids, interest points, least-squares matching, tracks.

Image coordinates count from the corner of the image: the centre of the first pixel is (0.5, 0.5), v points down. On
level l of a pyramid they are those of level 0 divided by 2^l. Readers and detectors with other origins are converted.

    what                                                        file
    packages of the extra `measure`, loaded when used           extra
    problems of photographs, all at once                        image_problems
    files of photographs: headers, pixels in strips             photographs
    the rule of the levels, coordinates between levels          levels
    pyramids in files, windows of them                          pyramid_file
    cubic B-splines and their exact derivatives                 spline
    types of matching: options, results, refusals               match_types
    least-squares matching of windows                           matching
    all images of a point, tied by the image equation           tied
    windows around points, pairs of them over many images       windows, window_pairs
    standard deviations of rays                                 ray_sigmas
    remeasuring the rays of a block                              refinement
    interest points, candidates of pairs, tracks                interest_points, match_candidates, tracks
    EXIF and XMP data of photographs                            exif, xmp
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
