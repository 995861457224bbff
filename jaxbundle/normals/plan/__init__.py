"""The plan of an elimination, on the host in numpy: made once per structure of a block, before tracing.

layout             static sizes, and positions of unknowns in the border
incidence          visibility: border points, cameras of single images, images connected by an observation
elimination_order  image pairs that share a point; the order in which the images are eliminated
tiling             points with short tracks as tiles of image slots by points
long_tiling        points on more images than a chunk has slots
pair_lists         block of an image pair for each pair of slots
panel_lists        symbolic factorisation: non-zero tiles of the reduced matrix, and the products that change them
reduced_plan       solver of the reduced equations: dense, in panels, or by conjugate gradients
elimination_plan   all of it together
"""
