from jaxbundle.geometry.similarity import Similarity as Similarity
from jaxbundle.orientation.absolute_orientations import (
    AbsoluteOrientation as AbsoluteOrientation,
    absolute_orientation as absolute_orientation,
)
from jaxbundle.orientation.approximation import Approximation as Approximation
from jaxbundle.orientation.direct_linear_transformations import (
    DirectLinearTransformation as DirectLinearTransformation,
    direct_linear_transformation as direct_linear_transformation,
)
from jaxbundle.orientation.from_nothing import approximate as approximate
from jaxbundle.orientation.intersection import intersect as intersect
from jaxbundle.orientation.planar_resections import (
    PlanarResection as PlanarResection,
    planar_resection as planar_resection,
)
from jaxbundle.orientation.relative_orientations import (
    RelativeOrientation as RelativeOrientation,
    relative_orientation as relative_orientation,
)
from jaxbundle.orientation.resections import Resection as Resection, resection as resection
from jaxbundle.orientation.three_point_resections import (
    ThreePointResection as ThreePointResection,
    three_point_resection as three_point_resection,
)
