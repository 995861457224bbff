"""Problems of photographs in the user's names, each with its cure, reported all at once."""

from collections.abc import Sequence

from jaxbundle.block.problems import Problem, printable


class ImageError(ValueError):
    """The error for unusable photographs, with all problems. The `table` of a problem is the path of the image.

    Example:
        >>> try:
        ...     jb.imagery.photograph("quarry/rays.csv")
        ... except jb.imagery.ImageError as error:
        ...     print(error.problems[0].cure)
        give a whole JPEG, PNG or TIFF file
    """

    def __init__(self, problems: Sequence[Problem]):
        self.problems = tuple(problems)
        lines = [printable(str(problem)) for problem in problems]
        head = "1 problem in the images" if len(lines) == 1 else f"{len(lines)} problems in the images"
        super().__init__("\n".join([f"{head}:", *(f"  {line}" for line in lines)]))
