from jaxbundle.imagery.image_problems import ImageError as ImageError
from jaxbundle.imagery.levels import between_levels as between_levels, halved as halved, level_sizes as level_sizes
from jaxbundle.imagery.match_types import Matches as Matches, MatchOptions as MatchOptions, Refusal as Refusal
from jaxbundle.imagery.matching import match as match
from jaxbundle.imagery.photographs import Photograph as Photograph, photograph as photograph
from jaxbundle.imagery.pyramid_file import Pyramid as Pyramid, pyramid as pyramid
from jaxbundle.imagery.refinement import Refinement as Refinement, refine as refine
from jaxbundle.imagery.tied import OrientedWindow as OrientedWindow, TiedMatch as TiedMatch, match_tied as match_tied
