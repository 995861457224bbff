"""Writing a drawing (DXF): layers POINTS, IMAGES, and RESIDUALS and ELLIPSES, which are enlarged."""

from pathlib import Path

from jaxbundle.io.formats.extras import extra
from jaxbundle.io.results.map_features import Features
from jaxbundle.io.results.maps import LINE, POINT, layers_of

COLOURS = {
    "points": 7,
    "images": 5,
    "residuals": 1,
    "ellipses": 3,
}  # colours of AutoCAD's index: white, blue, red, green
SHARE = 0.004  # share of the extent: height of the names


def write_dxf(features: Features, path: Path) -> None:
    """Writes points with their names, images, residual vectors and error ellipses.

    Raises: BlockError where ezdxf is not installed.
    """
    ezdxf = extra("ezdxf", f"writing {path.name}")
    drawing = ezdxf.new("R2010")
    space, height = drawing.modelspace(), max(SHARE * features.extent, 1e-6)
    for layer in layers_of(features):
        attributes = {"layer": layer.name.upper()}
        drawing.layers.add(attributes["layer"], color=COLOURS[layer.name])
        names = next(iter(layer.columns.values()))
        for name, shape in zip(names, layer.shapes, strict=True):
            places = [tuple(place) for place in shape.tolist()]
            if layer.geometry == POINT:
                space.add_point(places[0], dxfattribs=attributes)
                label = space.add_text(str(name), height=height, dxfattribs=attributes)
                label.set_placement(places[0])
            elif layer.geometry == LINE:
                space.add_line(*places, dxfattribs=attributes)
            else:
                space.add_polyline3d(places, dxfattribs=attributes)
    drawing.saveas(str(path))
