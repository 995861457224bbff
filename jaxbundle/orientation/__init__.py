"""Orientation of one photograph, of two, of a whole block without approximate values; and the check of such values.

one photograph      three_points, resection, direct_linear_transformation, planar_resection
two photographs     five_points, two_images, pair_search, coplanarity, relative_orientation
one model           absolute_orientation
a whole block       from_nothing chooses the way: oriented (resection of many images), or global_start:
                    common_rays -> block_pairs (minimal_samples, pair_kernel) -> rotation_average -> ray_votes
                    -> linear_positions -> robust_intersection -> anchors, to_object
values given        start: absurd ones are replaced
"""
