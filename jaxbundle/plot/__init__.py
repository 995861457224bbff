"""The pictures of a report in matplotlib: `jb.plot.NAME(result, ..., ax=None)` draws into one axes and returns it.

block, control, check       the plan, and differences at control and check points
residual_histogram          standardised residuals of the rays against the normal distribution
residual_field              mean residuals of a camera over its format
image_residuals, images     residuals of one image, and the rms of each image
correlations, distortion    correlations of interior elements, and distortion of a camera
precision_map, ellipses     precision of the object points over the block, and of the stations
redundancy                  redundancy numbers of the rays
connections                 images that see the same points
doming                      differences in height over the distance from the centre of the block
iterations                  effect of the iterations
compare                     differences between two results over their standard deviations

No function opens a window or changes settings of matplotlib. The numbers come from `report/pictures`, as in the
report.
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
