from jaxbundle.measuring.measurement import (
    CameraGiven as CameraGiven,
    Measured as Measured,
    MeasureOptions as MeasureOptions,
    measure as measure,
)
from jaxbundle.measuring.photo_set import read_positions as read_positions
