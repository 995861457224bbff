"""The host's plan of an elimination, numpy only: made once per structure of a block, before anything is traced.

layout             static sizes, and where an unknown stands in the border
incidence          who sees what: border points, own cameras, images joined by an observation
elimination_order  image pairs that share a point; the order in which the images are eliminated
tiling             points with short tracks as tiles of image slots by points
long_tiling        points on more images than a chunk has slots
pair_lists         which block of an image pair belongs to every pair of slots
panel_lists        symbolic factorisation: which tiles of the reduced matrix fill, and which products make them
reduced_plan       how the reduced equations are solved: dense, in panels, or by conjugate gradients
elimination_plan   all of it together
"""
