"""Independent models and independent strips: the two less rigorous methods of adjusting a block of photographs.

Both are adjusted by the engine of the bundle, with all its statistics.

    file                     content
    chains                   order of the images along strips
    formation                models of two photographs each, by relative orientation, with the errors of their points
    sensors                  a model as a sensor: 7 unknowns and 3 residuals per point
    translated               control, stations and navigation data of photographs, converted to models or strips
    sensor_block             a block of photographs as a block of models or strips
    model_block              the block of models
    photograph_orientations  orientations of the photographs from models or strips
    model_adjustment         the method of independent models
    plan_height_iteration    its iteration of plan and height
    joined                   strips joined from models, with the errors that add up along them
    polynomials              the corrections of strips, and a strip as a sensor with their coefficients
    strip_block              the blocks of strips: seven parameters each, then polynomials
    control_layout           whether the control of a strip is sufficient
    strip_adjustment         the method of independent strips
    propagation              standard deviations by the errors of the image coordinates
"""

from jaxbundle.numerics.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
