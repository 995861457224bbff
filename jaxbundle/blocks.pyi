from jaxbundle.block.block import (
    Block as Block,
    Camera as Camera,
    CheckPoints as CheckPoints,
    Datum as Datum,
    ExteriorOrientation as ExteriorOrientation,
    InteriorOrientation as InteriorOrientation,
    Parameter as Parameter,
    Rays as Rays,
    Structure as Structure,
)
from jaxbundle.block.changes import with_interior_held as with_interior_held
from jaxbundle.block.datum import with_datum as with_datum
from jaxbundle.block.datum_defect import DatumDefect as DatumDefect, datum_defect as datum_defect
from jaxbundle.block.findings import Finding as Finding, Kind as Kind, Severity as Severity, Subject as Subject
from jaxbundle.block.problems import BlockError as BlockError, Problem as Problem
from jaxbundle.block.validate import validate as validate
from jaxbundle.diagnosis.before import plausibility as plausibility, prepared as prepared
