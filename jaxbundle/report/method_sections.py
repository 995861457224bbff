"""Sections of the report of independent models or strips.

The photographs come first, as in a report of the bundle, so that reports can be compared; then the models or strips.
"""

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np

from jaxbundle.block.wording import RADIANS
from jaxbundle.independent.model_adjustment import ModelAdjustment
from jaxbundle.independent.propagation import Propagated
from jaxbundle.independent.strip_adjustment import StripAdjustment
from jaxbundle.report import sections as of_adjustment, unknown_sections as of
from jaxbundle.report.figures import Figures
from jaxbundle.report.section import (
    Facts,
    Picked,
    ReportColumn,
    ReportTable,
    Section,
    decimals,
    fact,
    first,
    fixed,
    measured,
    name_column,
    numbers,
    of_page,
    with_digits,
    with_unit,
)

MethodAdjustment = ModelAdjustment | StripAdjustment
COORDINATES, RESIDUALS = ("X", "Y", "Z"), ("vx", "vy", "vz")


def method_sections(
    result: MethodAdjustment, figures: Figures, precision: Propagated | None
) -> list[Callable[[], Section]]:
    """The sections in their order. `figures`: numbers of the adjustment of models or strips."""
    photographs = as_photographs(result, figures, precision)
    own = (_models, _model_points) if isinstance(result, ModelAdjustment) else (_strips, _coefficients, _corrected)
    groups = of_adjustment.group_sections(figures)
    return [
        partial(of_adjustment.verdict_section, figures),
        partial(_method, result, precision),
        partial(of_adjustment.adjustment_section, figures),
        partial(of_adjustment.observations_section, figures),
        partial(of.images, photographs),
        partial(of.points, photographs),
        *groups,
        partial(of.check_points, photographs),
        *(partial(section, result, figures) for section in own),
        partial(of_adjustment.reliability_section, figures),
    ]


def as_photographs(result: MethodAdjustment, figures: Figures, precision: Propagated | None) -> Figures:
    """The numbers of the photographs: orientations and points with standard deviations.

    Standard deviations are those of the method, or by propagation where known.
    """
    block, count = result.block, len(result.points)
    structure, radians = block.structure, RADIANS[block.structure.angle_unit]
    exterior = np.hstack([block.exterior.projection_centre, np.asarray(block.exterior.angles) / radians])
    exterior_sd = result.oriented.standard_deviations / np.array([1.0] * 3 + [radians] * 3)
    exterior_sd = np.where(structure.exterior_free, exterior_sd, 0.0)
    points_sd = np.where(structure.point_free, np.nan, 0.0)
    deviations = figures.points_sd if precision is None else precision.standard_deviations.object_points
    points_sd[result.points] = np.where(structure.point_free[result.points], deviations[:count], 0.0)
    if precision is not None:
        known = np.isfinite(result.oriented.exterior[:, 0])
        centres = np.full((len(structure.image_names), 3), np.nan)
        centres[known] = deviations[count:]
        exterior_sd[:, :3] = np.where(structure.exterior_free[:, :3], centres, 0.0)
    rays = np.zeros(len(structure.point_names), int)
    rays[result.points] = figures.rays_of_point[:count]
    points = np.asarray(block.object_points)
    return dataclasses.replace(
        figures,
        structure=structure,
        exterior=exterior,
        exterior_sd=exterior_sd,
        points=points,
        points_sd=points_sd,
        check_differences=points[structure.check_point] - np.asarray(block.check_points.coordinates),
        rays_of_point=rays,
        rays_of_image=np.bincount(structure.ray_image, minlength=len(structure.image_names)),
    )


def _method(result: MethodAdjustment, precision: Propagated | None) -> Section:
    """Section with the method and the origin of its standard deviations."""
    if isinstance(result, ModelAdjustment):
        shared = result.adjustment.block.structure.model.elements[1:]
        text = f"independent models, {len(result.models)} of two images, 7 unknowns each"
        text += ", and the common errors of all points of a model" if shared else ""
        method = "models"
    else:
        text = f"independent strips, {len(result.strips)} of {len(result.models)} models: "
        text += result.adjustment.block.structure.model.name.removeprefix("strip, ")
        method = "strips"
    facts = [fact("Method", text, method_of_adjustment=method)]
    if precision is None:
        facts.append(fact("Precision", "from the weights of the method, which neglect errors that points share"))
    else:
        words = "points and projection centres by propagation of the errors of the image coordinates, on average"
        words += f" {precision.ratio:.2f} times those from the weights; sigma0 of the image coordinates"
        words += f" {precision.sigma0:.4g}"
        entries = {"sigma0_of_image_coordinates": precision.sigma0, "precision_ratio": precision.ratio}
        facts.append(fact("Precision", words, **entries))
    return Section("Method", (Facts(tuple(facts), 23),))


def _models(result: ModelAdjustment, figures: Figures) -> Section:
    """A table of the seven parameters of each model, with statistics of its points."""
    s, unit = figures.structure, figures.structure.object_unit
    units = [unit] * 3 + [s.angle_unit] * 3
    v, count = result.residuals, len(s.image_names)
    used = result.models.used
    parallax = np.sqrt(np.sum(np.where(used, result.models.parallaxes, 0.0) ** 2, 1) / np.maximum(used.sum(1) - 5, 1))
    rms = [np.sqrt(np.bincount(s.ray_image, v[:, k] ** 2, count) / figures.rays_of_image) for k in range(3)]
    scale, scale_sd = figures.interior[:, :1], figures.interior_sd[:, :1]
    columns = (
        name_column("model", s.image_names),
        *measured(s.exterior_elements, figures.exterior, figures.exterior_sd, units, _places(figures.exterior_sd)),
        *measured(("scale",), scale, scale_sd, ("",), _places(scale_sd)),
        ReportColumn("points", figures.rays_of_image, "points", place=1),
        ReportColumn("parallax", parallax, "y-parallax/sigma", with_digits(3), 1),
        *numbers([f"rms {c}" for c in RESIDUALS], np.stack(rms, 1)),
    )
    every = np.arange(count)
    table = ReportTable("models", columns, *first(every, of.IMAGES, "models"), results=every, below=True)
    return Section("Models: adjusted values and standard deviations", (table,))


def _places(deviations: np.ndarray) -> list[int]:
    return [decimals(column) for column in deviations.T]


def _model_points(result: ModelAdjustment, figures: Figures) -> Section:
    """A table of residuals of model points in the systems of their models; the text shows the largest ones."""
    s = figures.structure
    size = np.linalg.norm(figures.normalised[0], axis=1) / max(figures.sigma0, np.finfo(float).tiny)
    worst = np.argsort(-size, kind="stable")[: of_adjustment.WORST]
    x = np.asarray(figures.adjustment.block.rays.coordinates)[:, :3]
    unit = s.object_unit
    columns = (
        name_column("model", Picked(s.image_names, s.ray_image)),
        name_column("point", Picked(s.point_names, s.ray_point), 26),
        *numbers(("x", "y", "z"), x),
        *numbers(RESIDUALS, result.residuals, [with_unit(c, unit) for c in RESIDUALS], show=with_digits(3)),
        ReportColumn("t", size, "|v|/(sigma0 sigma)", lambda value: fixed(value, 2)),
    )
    table = ReportTable("model_points", columns, worst)
    return Section("Model points with the largest residuals, in the systems of their models", (table,))


def _strips(result: StripAdjustment, figures: Figures) -> Section:
    """A table of the strips: images, models, and scatter of the transferred scale."""
    s, names = figures.structure, result.block.structure.image_names
    strips = result.strips
    columns = (
        name_column("strip", s.image_names),
        ReportColumn("first", [names[strip.images[0]] for strip in strips], "first", place=0),
        ReportColumn("last", [names[strip.images[-1]] for strip in strips], "last", place=0),
        ReportColumn("models", np.array([len(strip.models) for strip in strips]), "models", is_result=True),
        ReportColumn("points", np.array([len(strip.points) for strip in strips]), "points", is_result=True),
        ReportColumn("scatter", np.array([strip.scatter for strip in strips]), "scatter of scale", with_digits(2)),
        ReportColumn(
            "half_length",
            np.array([f.half_length for f in result.frames]),
            "half length",
            with_digits(5),
            is_result=True,
        ),
        ReportColumn(
            "half_width", np.array([f.half_width for f in result.frames]), "half width", with_digits(5), is_result=True
        ),
    )
    every = np.arange(len(strips))
    return Section("Strips", (ReportTable("strips", columns, *first(every, of.IMAGES, "strips"), results=every),))


def _coefficients(result: StripAdjustment, figures: Figures) -> Section:
    """A table of the coefficients of the polynomials: the contribution of each term at the end or edge of its strip."""
    s = figures.structure
    elements = s.cameras[0].model.elements
    rows = [(k, e) for k in range(len(s.image_names)) for e in range(len(elements))]
    strip, element = np.array(rows).T
    columns = (
        name_column("strip", Picked(s.image_names, strip)),
        ReportColumn("coefficient", Picked(elements, element), "coefficient", place=0, is_name=True),
        ReportColumn("value", figures.interior[strip, element], "value", with_digits(5), is_result=True),
        ReportColumn("sd", figures.interior_sd[strip, element], "sd", with_digits(2), deviation_of="value"),
    )
    every = np.arange(len(rows))
    shown = first(every, of.POINTS, "coefficients")
    title = with_unit("Polynomials: contribution of each term at the end or edge of the strip", s.object_unit)
    return Section(title, (ReportTable("coefficients", columns, *shown, results=every),))


def _corrected(result: StripAdjustment, figures: Figures) -> Section:
    """A table of the corrected points of each strip, and the corrections; the text has their maximum."""
    s, photographs = figures.structure, result.block.structure
    strip = np.repeat(np.arange(len(result.corrected)), [len(c.point) for c in result.corrected])
    point = np.concatenate([c.point for c in result.corrected])
    dx = np.concatenate([c.corrections for c in result.corrected])
    columns = (
        name_column("strip", Picked(s.image_names, strip)),
        name_column("point", Picked(photographs.point_names, point)),
        *numbers(COORDINATES, np.concatenate([c.coordinates for c in result.corrected])),
        *numbers([f"d{c}" for c in COORDINATES], dx),
    )
    table = ReportTable("corrected_points", columns, np.zeros(0, int))
    largest = [np.abs(c.corrections).max(0) for c in result.corrected]
    page = (
        name_column("strip", s.image_names),
        *(of_page(f"maximum d{c}", np.array([row[k] for row in largest]), with_digits(3)) for k, c in enumerate("XYZ")),
    )
    every = np.arange(len(largest))
    title = with_unit("Corrections of the strips by their polynomials", s.object_unit)
    return Section(title, (ReportTable("largest_corrections", page, every, in_file=False), table))
