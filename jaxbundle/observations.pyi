from jaxbundle.block.geodetic import (
    DISTANCES as DISTANCES,
    LINES as LINES,
    PLANES as PLANES,
    geodetic_kind as geodetic_kind,
)
from jaxbundle.block.navigation import ATTITUDES as ATTITUDES, GNSS_STATIONS as GNSS_STATIONS
from jaxbundle.block.observation_kinds import (
    CONTROL as CONTROL,
    PARAMETERS as PARAMETERS,
    STATIONS as STATIONS,
    ObservationGroup as ObservationGroup,
    ObservationKind as ObservationKind,
    interior_priors as interior_priors,
    observation_group as observation_group,
)
