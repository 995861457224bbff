"""The numbers of the pictures of a report: pure functions, used by the page and the plots.

known            values that can be drawn: finite numbers, limits of an axis
plan_picture     stations, outlines of images, object points and their role
vector_pictures  differences at control points and check points, their statistics and tests
ray_pictures     standardised residuals: histogram, normal quantiles, by image, mean field of a camera
camera_pictures  distortion curves with their band, correlations of interior elements
point_pictures   precision over the block, number of rays
doming           heights at control and check points over the block
network          images that see the same points
"""
