"""Results in words, tables and pictures: pure functions of an adjustment, and those that write them.

sections         what a report consists of, made once; text, data, files and html render it
pictures         the numbers of the pictures, which html and plot draw alike
html             the page; `jaxbundle.plot` draws the same pictures in matplotlib
comparison       two results of one block, or two surveys of the same points
point_cloud      point clouds for viewers
made             program, date, command and inputs
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
