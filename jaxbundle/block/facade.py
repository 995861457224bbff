"""The interface of a block for users: made from tables, read by names, values replaced by names."""

from collections.abc import Mapping
from typing import Any, Self

import equinox as eqx
from jaxtyping import Array, Float

from jaxbundle.block.named import CameraValues, ImageValues, Named, PointValues
from jaxbundle.block.new_values import with_arrays, with_interior, with_observations, with_points, with_sigmas
from jaxbundle.numerics.offered import offered


class Facade(eqx.Module):
    """Base class with the methods of a block that use names; `Block` has the values."""

    structure: eqx.AbstractVar[Any]
    exterior: eqx.AbstractVar[Any]
    interior: eqx.AbstractVar[Any]
    object_points: eqx.AbstractVar[Float[Array, "point 3"]]

    @classmethod
    def from_tables(
        cls,
        *,
        cameras: Mapping[str, Mapping[str, Any]],
        images: Any,
        rays: Any,
        sigma: float | None = None,
        object_unit: str = "m",
        angle_unit: str = "deg",
        rotation: str = "omega-phi-kappa",
        datum: Mapping[str, Any] | None = None,
        navigation: Mapping[str, Mapping[str, Any]] | None = None,
        identification: Mapping[str, float] | None = None,
        name: str = "",
        check_start: bool = True,
        **tables: Any,
    ) -> Self:
        """Makes a block from tables in memory, with the columns of the block folder.

        A table is a polars or pandas frame, a mapping of column names to sequences, or the path of a CSV file. Empty
        fields are None or NaN. All checks and messages are those of the block folder; a message names table and row.

        Args:
            cameras: For each camera its section of block.toml, such as `{"c": {"image_unit": "px",
                "principal_distance": 3000.0, "principal_point": [2000.0, 1500.0]}}`.
            images: image, camera, X0, Y0, Z0 and the three angles of the rotation system.
            rays: image, point, x, y in the unit of the camera, and sx, sy where they differ from `sigma`.
            sigma: Standard deviation of an image coordinate, in the unit of the rays.
            object_unit: "m" or "mm".
            angle_unit: "deg", "gon" or "rad".
            rotation: Name of the system of the three angles.
            datum: The section [datum], such as `{"type": "inner"}`.
            navigation: The sections [navigation.NAME].
            identification: The section [identification].
            name: Name of the block.
            check_start: As for `jaxbundle.read`.
            **tables: Further tables by their kind: control, points, stations, attitudes, distances and so on.

        Returns:
            The block; approximate coordinates that are not given are intersected.

        Raises:
            BlockError: with all problems of settings and tables.

        Example:
            block = jb.Block.from_tables(
                cameras={"c": {"image_unit": "px", "principal_distance": 3000.0}},
                images={"image": ["1", "2"], "camera": ["c", "c"], "X0": [0.0, 60.0], ...},
                rays=pl.read_csv("rays.csv"),
                control={"point": ["A"], "X": [1.0], "Y": [2.0], "Z": [3.0], "sX": [0.01], ...},
                sigma=0.5,
            )
        """
        sections = {
            "name": name,
            "units": {"object": object_unit, "angle": angle_unit},
            "rotation": {"system": rotation},
            "cameras": cameras,
            "sigma": None if sigma is None else {"image": sigma},
            "datum": datum,
            "navigation": navigation,
            "identification": identification,
        }
        given = {key: value for key, value in sections.items() if value is not None}
        tables = {
            "images": images,
            "rays": rays,
            **{kind: table for kind, table in tables.items() if table is not None},
        }
        return offered("block_from_tables")(tables, given, check_start=check_start)

    def replace(
        self,
        *,
        image_coordinates: Any = None,
        object_points: Any = None,
        projection_centres: Any = None,
        angles: Any = None,
        interior: Any = None,
        sigmas: Mapping[str, Any] | None = None,
        **observations: Any,
    ) -> Self:
        """Returns the block with other values and the same structure. Values may be tracers of jit, grad and vmap.

        Args:
            image_coordinates: One row per ray, in the unit of the camera.
            object_points: One row per point, or coordinates by name, such as `{"20": (1.0, 2.0, 3.0)}`.
            projection_centres: One row per image.
            angles: One row per image, in radians.
            interior: One row per camera, or elements by name, such as `{"c": {"K1": 1e-8}}`.
            sigmas: Standard deviations by table, such as `{"rays": 0.5, "control": 0.02}`: a number for all rows, or an
                array of the shape of the table.
            **observations: Observed values by table: an array of all rows, or values by name, such as
                `control={"20": (X, Y, Z)}`. Control by name replaces fixed coordinates too.

        Raises:
            ValueError, KeyError: for a shape or a name that is not in the block.

        Example:
            block.replace(sigmas={"rays": 0.5}, interior={"c": {"principal_distance": 3012.0}})
        """
        block = with_arrays(
            self,
            {
                "rays.coordinates": image_coordinates,
                "exterior.projection_centre": projection_centres,
                "exterior.angles": angles,
            },
        )
        block = block if object_points is None else with_points(block, object_points)
        block = block if interior is None else with_interior(block, interior)
        for table, values in observations.items():
            block = with_observations(block, table, values)
        return with_sigmas(block, sigmas or {})

    @property
    def points(self) -> Named[PointValues]:
        """The object points by name."""
        return Named(
            "point",
            self.structure.point_names,
            lambda k: PointValues(self.structure.point_names[k], self.object_points[k]),
        )

    @property
    def images(self) -> Named[ImageValues]:
        """The images by name."""
        s, exterior = self.structure, self.exterior

        def image(k: int) -> ImageValues:
            camera = s.cameras[s.image_camera[k]].name
            return ImageValues(s.image_names[k], camera, exterior.projection_centre[k], exterior.angles[k])

        return Named("image", s.image_names, image)

    @property
    def cameras(self) -> Named[CameraValues]:
        """The cameras by name, with their interior elements by name."""
        return self.cameras_with(None)

    def cameras_with(self, deviations: Any) -> Named[CameraValues]:
        """The cameras by name, with standard deviations of their interior elements."""
        cameras = self.structure.cameras

        def camera(k: int) -> CameraValues:
            names = cameras[k].model.elements
            units = [cameras[k].unit_of(name) for name in names]
            own = None if deviations is None else deviations[k]
            return CameraValues(cameras[k].name, names, units, self.interior.elements[k], own)

        return Named("camera", [camera.name for camera in cameras], camera)
