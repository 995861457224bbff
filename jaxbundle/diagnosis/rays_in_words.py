"""Rays as subjects of findings, and their words in a sentence."""

from jaxbundle.block.block import Structure
from jaxbundle.block.findings import Subject


def ray_subject(structure: Structure, ray: int) -> Subject:
    """Subject of a finding: image and point of a ray."""
    image, point = structure.ray_image[ray], structure.ray_point[ray]
    return Subject("rays", (structure.image_names[image], structure.point_names[point]))


def ray_name(structure: Structure, ray: int) -> str:
    """Words for a ray in a sentence."""
    subject = ray_subject(structure, ray)
    return f"point {subject.names[1]} on image {subject.names[0]}"
