from jaxbundle.solve.adjust import Progress as Progress
from jaxbundle.solve.adjustment import Adjustment as Adjustment, Status as Status
from jaxbundle.solve.batch import Batch as Batch, Outcome as Outcome
