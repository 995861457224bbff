"""The report as one HTML page: needs no network, readable without scripts, interactive with them.

markup          elements and escaped text
axes            axes of a chart in SVG: scales, ticks, labels; plans with equal scales
raster          small PNG pictures for maps with many cells
charts          single charts: histograms, lines, matrices
drawings        plans: the block, arrows at control and check points, connections, precision
html_tables     facts and tables of the sections
verdict_tiles   tiles, and findings with links to their rows
packed_scene    the block as data for the script: positions and names, packed
chapters        content of each chapter
page            the whole page, with its content security policy
page.css        style; page.js: sorting, searching, interactive plan
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
