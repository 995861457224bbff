"""Accuracy before the flight: simulated flights, their predicted precision, and the design of their control.

flight              description of a flight: camera, strips, terrain, tie points, control, navigation, errors
lines, ground       stations of the images; positions of the points
drawn_flight        a random realisation of a flight: true orientations and points, visible points
navigation_errors   observed centres and attitudes with their systematic errors
assembly, exact     the block of a scene; image coordinates without residuals
simulation          a block with known truth
prediction          covariance of a block without noise and without a solve
accuracy            measures of a prediction, and the check of a specification
monte_carlo_runs    many complete adjustments against the prediction
design_derivatives  derivatives of a measure by positions, sigmas, overlaps and height
control_candidates  covariances of a block and of possible positions of control
control_search      exchange of control points on the covariance; lower bound of all layouts
sensitivities       derivatives of an adjusted coordinate with respect to all input values
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
