"""Independent models and independent strips: the two less rigorous methods of adjusting a block of photographs.

Both are adjusted by the engine of the bundle, with all its statistics.

    file            what stands there
    chains          which images follow each other along a strip
    started         orientations that are not given, found from the rays
    formation       models of two photographs each, by relative orientation, with the errors of their points
    sensors         a model as a sensor: 7 unknowns and 3 residuals per point
    translated      control, stations and navigation data of photographs, said of models or strips
    sensor_block    a block of photographs as a block of models or strips
    model_block     the block of models
    photographs     orientations of the photographs from models or strips
    adjust_models   the method of independent models
    plan_height     its iteration of plan and height
    joined          strips joined from models, with the errors that add up along them
    polynomials     the corrections of strips, and a strip as a sensor with their coefficients
    strip_block     the blocks of strips: seven parameters each, then polynomials
    layout          whether the control of a strip suffices
    adjust_strips   the method of independent strips
    propagation     standard deviations by the errors of the image coordinates
"""
