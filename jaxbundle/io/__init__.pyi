from jaxbundle.io.bal import read_bal as read_bal, write_bal as write_bal
from jaxbundle.io.block_folder import read_block_folder as read_block_folder
from jaxbundle.io.block_folder_writer import write_block_folder as write_block_folder
from jaxbundle.io.flight_toml import read_flight as read_flight
from jaxbundle.io.formats.format_table import write_format as write_format
from jaxbundle.io.formats.side_tables import Sources as Sources
from jaxbundle.io.reading import read as read
from jaxbundle.io.results.export import export as export
