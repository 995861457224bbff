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
    rays of a block measured again                              refine
    interest points, candidates of pairs, tracks                features, candidates, tracks
    what photographs say of themselves                          exif
"""

from jaxbundle.imagery.image_problems import ImageError
from jaxbundle.imagery.levels import between_levels, halved, level_sizes
from jaxbundle.imagery.match_types import Matches, MatchOptions, Refusal
from jaxbundle.imagery.matching import match
from jaxbundle.imagery.photographs import Photograph, photograph
from jaxbundle.imagery.pyramid_file import Pyramid, pyramid
from jaxbundle.imagery.refine import Refinement, refine
from jaxbundle.imagery.tied import OrientedWindow, TiedMatch, match_tied

__all__ = [
    "ImageError",
    "MatchOptions",
    "Matches",
    "OrientedWindow",
    "Photograph",
    "Pyramid",
    "Refinement",
    "Refusal",
    "TiedMatch",
    "between_levels",
    "halved",
    "level_sizes",
    "match",
    "match_tied",
    "photograph",
    "pyramid",
    "refine",
]
