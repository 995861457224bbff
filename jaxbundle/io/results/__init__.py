"""Results in the formats of maps, point clouds and drawings, for display in other programs.

map_features  points, images, residual vectors and error ellipses of a block or an adjustment, in its object system
clouds        PLY; LAS and LAZ (package laspy)
maps          GeoJSON (pyproj), GeoPackage (pyogrio), KML (pyproj)
drawing       DXF (ezdxf)
export        `export(result, path)`: the suffix determines the format
"""
