"""A photogrammetric bundle adjuster in JAX, differentiable with respect to all input values.

    import jax; jax.config.update("jax_enable_x64", True)
    import jaxbundle as jb

    block = jb.read("folder")
    result = jb.adjust(block)
    print(result.summary())
    result.standard_deviations.object_points

The most frequent names are at top level, all others in namespaces:

    blocks          parts of a block, its datum, its checks before an adjustment
    observations    kinds and groups of observations that are not image points
    cameras         camera models, corrections, inner orientation
    robust          weight functions
    stopping        stopping rules
    results         types of the result of an adjustment
    statistics      precision, reliability, tests, variance components, influence
    orientation     one photograph, two photographs, a block without approximate values
    independent     independent models and strips
    planning        simulated flights, predicted precision, design
    imagery         photographs, matching
    measuring       from photographs to a block folder
    io, report      files of blocks; reports of results
    plot            pictures in matplotlib
    textbook        formulas of Text 000, compared with autodiff; laws of accuracy

In the examples of docstrings `block` is `jb.read("quarry")`, the block that `jaxbundle new quarry` writes, `result` is
`jb.adjust(block)`, and `plan`, `flight`, `prediction` are those of a flight of three images.

Names are imported when they are first used: the help of the command line does not wait for JAX.
"""

from jaxbundle.numerics.lazy_names import lazy_names

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
