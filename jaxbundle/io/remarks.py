"""The finding that names points measured more than once on an image."""

from collections.abc import Sequence

from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.io.noted import listed

SUBJECTS = 1000  # of one finding


def measured_again(rays: Sequence[tuple[str, str]]) -> Finding:
    """A finding about rays, given by image and point, whose point an earlier ray of the same image has measured."""
    subjects = tuple(Subject("rays", (image, point)) for image, point in rays[:SUBJECTS])
    if len(rays) == 1:
        image, point = rays[0]
        what = f"point {listed([point])} is measured twice on image {listed([image])}; both are used as observations"
    else:
        points = listed(list(dict.fromkeys(point for _, point in rays)))
        what = (
            f"{len(rays)} rays measure a point again on the same image; all are used as observations: points {points}"
        )
    cure = "drop the wrong ones if each point was meant to be measured once"
    return Finding(Kind.INFORMATION, what, cure, subjects, grade=Severity.CHECK)
