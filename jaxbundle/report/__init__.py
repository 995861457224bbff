"""Reports of results: texts, tables and pictures as pure functions of an adjustment, and functions that write them.

sections         the content of a report; text, data, files and html render it
pictures         the numbers of the pictures, drawn by html and plot
html             the HTML page; `jaxbundle.plot` draws the same pictures in matplotlib
comparison       two results of one block, or two surveys of the same points
surveys          the test of two surveys by their covariances
point_cloud      point clouds and stations for viewers; rerun_file: for the viewer Rerun
made             program, date, command and inputs
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
