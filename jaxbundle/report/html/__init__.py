"""The report as one HTML page: no request to any network, readable without scripts, interactive with them.

markup          elements and escaped text
axes            axes of a chart in SVG: scales, ticks, labels; plans with equal scales
raster          a small picture in PNG, for maps of many cells
charts          histograms, lines, matrices of one chart each
drawings        plans: the block, arrows at control and check points, connections, precision
html_tables     facts and tables of the sections
verdict_tiles   tiles, and findings with links to their rows
packed_scene    the block as data for the script: positions and names, packed
chapters        what stands in each chapter
page            the whole page, with its content security policy
page.css        the look, page.js: sorting, searching, the plan that can be moved
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
