from jaxbundle.statistics.components import (
    VarianceComponents as VarianceComponents,
    variance_components as variance_components,
)
from jaxbundle.statistics.control_errors import control_influence as control_influence, influence as influence
from jaxbundle.statistics.covariance import (
    covariance_of as covariance_of,
    error_ellipses as error_ellipses,
    error_ellipsoids as error_ellipsoids,
)
from jaxbundle.statistics.reliability_tables import Reliability as Reliability, reliability as reliability
from jaxbundle.statistics.snooping import Snooping as Snooping, snoop as snoop
from jaxbundle.statistics.subsets import (
    Subset as Subset,
    all_control as all_control,
    camera_rays as camera_rays,
    control_point as control_point,
    control_rays as control_rays,
    default_groups as default_groups,
    image_rays as image_rays,
    observations_of_kind as observations_of_kind,
    tie_rays as tie_rays,
)
