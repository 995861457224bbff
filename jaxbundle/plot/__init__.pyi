from jaxbundle.plot.camera_plots import (
    correlations as correlations,
    distortion as distortion,
    residual_field as residual_field,
)
from jaxbundle.plot.chart_plots import (
    doming as doming,
    image_residuals as image_residuals,
    images as images,
    iterations as iterations,
    redundancy as redundancy,
    residual_histogram as residual_histogram,
)
from jaxbundle.plot.comparison_plots import compare as compare
from jaxbundle.plot.plan_plots import (
    block as block,
    check as check,
    connections as connections,
    control as control,
    ellipses as ellipses,
    precision_map as precision_map,
)
