"""Orientation of one photograph, of two, of a whole block without approximate values; and the check of such values.

one photograph      three_points, three_point_resections, resections, direct_linear_transformations, planar_resections
two photographs     five_points, two_images, pair_search, coplanarity, relative_orientations
one model           absolute_orientations
a whole block       from_nothing chooses the method: oriented (resection of many images), or global_start:
                    common_rays -> block_pairs (minimal_samples, pair_kernel) -> triplets, rotation_average
                    -> ray_votes -> linear_positions -> anchors, to_object -> robust_intersection, scale_joints
given values        checked_start: absurd values are replaced
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
