from jaxbundle import (
    blocks as blocks,
    cameras as cameras,
    imagery as imagery,
    independent as independent,
    io as io,
    measuring as measuring,
    observations as observations,
    orientation as orientation,
    planning as planning,
    plot as plot,
    report as report,
    results as results,
    robust as robust,
    statistics as statistics,
    stopping as stopping,
    textbook as textbook,
)
from jaxbundle.block.block import Block as Block
from jaxbundle.block.problems import BlockError as BlockError
from jaxbundle.camera.collinearity import collinearity as collinearity
from jaxbundle.diagnosis.adjusted import findings as findings
from jaxbundle.io.block_folder_writer import write_block_folder as write_block_folder
from jaxbundle.io.reading import read as read
from jaxbundle.io.results.export import export as export
from jaxbundle.orientation.from_nothing import approximate as approximate
from jaxbundle.planning.simulation import simulate as simulate
from jaxbundle.report.files import write_report as write_report
from jaxbundle.solve.adjust import adjust as adjust
from jaxbundle.solve.adjustment import Adjustment as Adjustment, Status as Status
from jaxbundle.solve.batch import adjust_many as adjust_many
from jaxbundle.solve.options import Options as Options
from jaxbundle.statistics.covariance import covariance_of as covariance_of
from jaxbundle.statistics.snooping import snoop as snoop

__version__: str
