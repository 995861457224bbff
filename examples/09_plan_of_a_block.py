"""The picture of the README: plan of a block with stations, points and error ellipses, written as plan.svg.

The block is the one of `jaxbundle new`. Stations are squares with the ground that their images cover, control points
triangles, the check point a cross, tie points circles. The ellipses are standard error ellipses, magnified.
"""

import sys
from pathlib import Path

import jax
import numpy as np

import jaxbundle as jb

jax.config.update("jax_enable_x64", True)

MAGNIFIED = 200  # the ellipses
SCALE, LEFT, TOP = 5.0, 430.0, 285.0  # pixels per metre; the corner of the picture in the object system

folder = Path(jb.__file__).parent / "docs" / "template"
block = jb.read(folder)
result = jb.adjust(block)
control = {block.structure.point_names[k] for group in block.groups for k in group.structure.indices[:, 0]}
check = {block.structure.point_names[k] for k in block.structure.check_point}


def place(position) -> tuple[float, float]:
    """x to the right, y down, in pixels of the picture."""
    return SCALE * (float(position[0]) - LEFT), SCALE * (TOP - float(position[1]))


def symbol(name: str, x: float, y: float) -> str:
    """Triangle, cross or circle."""
    if name in control:
        return f'<path d="M{x:.0f} {y - 7:.0f}l7 12h-14z" fill="#c33"/>'
    if name in check:
        return f'<path d="M{x - 6:.0f} {y - 6:.0f}l12 12m0 -12l-12 12" stroke="#06c" stroke-width="2"/>'
    return f'<circle cx="{x:.0f}" cy="{y:.0f}" r="4" fill="#555"/>'


width, height = SCALE * 180, SCALE * 130
shapes = []
for image in result.images.values():
    x, y = place(image.projection_centre)
    half = 3000 / 4000 * 100 * SCALE, 2000 / 4000 * 100 * SCALE  # 6000 x 4000 px, c = 4000 px, 100 m above ground
    turn = -np.degrees(float(image.angles[2]))
    shapes.append(
        f'<rect x="{x - half[0]:.0f}" y="{y - half[1]:.0f}" width="{2 * half[0]:.0f}" height="{2 * half[1]:.0f}"'
        f' transform="rotate({turn:.1f} {x:.0f} {y:.0f})" fill="#06c" fill-opacity=".06" stroke="#06c"'
        ' stroke-opacity=".4"/>'
    )
    shapes.append(f'<rect x="{x - 5:.0f}" y="{y - 5:.0f}" width="10" height="10" fill="#06c"/>')
    shapes.append(f'<text x="{x + 9:.0f}" y="{y + 5:.0f}">image {image.name}</text>')
ellipses = jb.statistics.error_ellipses(result)
for point, axes, directions in zip(result.points.values(), ellipses.semi_axes, ellipses.directions, strict=True):
    x, y = place(point.coordinates)
    turn = -np.degrees(np.arctan2(directions[1, 0], directions[0, 0]))
    rx, ry = axes * MAGNIFIED * SCALE
    shapes.append(f'<g transform="rotate({turn:.0f} {x:.0f} {y:.0f})" fill="none" stroke="#393">')
    shapes.append(f'<ellipse cx="{x:.0f}" cy="{y:.0f}" rx="{rx:.1f}" ry="{ry:.1f}"/></g>')
    shapes.append(symbol(point.name, x, y) + f'<text x="{x + 9:.0f}" y="{y - 8:.0f}">{point.name}</text>')
head = (
    f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" font-family="sans-serif"'
    f' font-size="16"><rect width="{width:.0f}" height="{height:.0f}" fill="#fff"/>'
)
bar = (
    f'<path d="M20 {height - 20:.0f}h{20 * SCALE:.0f}" stroke="#000" stroke-width="3"/><text x="20"'
    f' y="{height - 28:.0f}">20 m; ellipses {20 / MAGNIFIED * 100:.0f} cm</text>'
)
plan = Path(sys.argv[1] if len(sys.argv) > 1 else "plan.svg")
plan.write_text("\n".join([head, *shapes, bar, "</svg>"]) + "\n")
print(f"plan of {len(result.images)} images and {len(result.points)} points: {plan.name}")
