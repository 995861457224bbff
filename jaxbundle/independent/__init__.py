"""Independent models and independent strips: the two less rigorous methods of adjusting a block of photographs.

    file            what stands there
    chains          which images follow each other along a strip
    formation       models of two photographs each, by relative orientation, with their covariances
    sensors         a model and a strip as sensors: 7 unknowns, or the coefficients of polynomials, 3 residuals per point
    translated      control, stations, navigation data and held elements of photographs, for models and strips
    model_block     a block of photographs as a block of models
    photographs     orientations of the photographs from adjusted models
    adjust_models   the method of independent models

Both methods are adjusted by the engine of the bundle, with all its statistics.
"""
