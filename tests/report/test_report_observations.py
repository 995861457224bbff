"""Parameters, tables of observations between all sorts of ends, robust weights and free networks in the report."""

import dataclasses
import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest
from cases.same_block import number
from cases.simulated_blocks import small_block
from cases.surveyed_site import BARS, GON, PAIRS, make_surveyed_folder

from jaxbundle.block.block import Datum
from jaxbundle.block.findings import Kind, Subject
from jaxbundle.block.observation_kinds import ObservationKind, observation_group
from jaxbundle.diagnosis.adjusted import findings
from jaxbundle.io import read_block_folder
from jaxbundle.report import files, report_dict, report_text, write_report
from jaxbundle.report.group_tables import table_names
from jaxbundle.report.text import WIDTH
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Reweighting


@pytest.fixture(scope="module")
def adjustment(tmp_path_factory: pytest.TempPathFactory):
    return adjust(read_block_folder(make_surveyed_folder(tmp_path_factory.mktemp("surveyed") / "site")))


@pytest.fixture(scope="module")
def folder(adjustment, tmp_path_factory: pytest.TempPathFactory):
    return write_report(adjustment, tmp_path_factory.mktemp("report") / "results")


@pytest.fixture(scope="module")
def simple():
    """Of a block without parameters."""
    return adjust(small_block().block)


def words(adjustment) -> list[str]:
    return [finding.words for finding in findings(adjustment)]


# Parameters


def test_parameters_in_the_users_units(adjustment, folder) -> None:
    parameters, sd = report_dict(adjustment)["parameters"], adjustment.standard_deviations.parameters
    block = adjustment.block
    for name, unit, factor in (("boresight phi of strip 1", "gon", GON), ("shift X of strip 1", "m", 1.0)):
        k = number(block, name)
        expected = [float(block.parameters[k]) / factor, float(sd[k]) / factor]
        assert parameters[name]["value"] == pytest.approx(expected, rel=1e-13) and parameters[name]["unit"] == unit
        assert parameters[name]["t"] == pytest.approx(abs(expected[0]) / expected[1], rel=1e-13)
    assert parameters["length of bar known"]["value"][1] == 0.0
    table = pl.read_csv(folder / "parameters.csv")
    assert table.columns == ["parameter", "value", "sd", "unit", "t"]
    assert table["parameter"].to_list() == [parameter.name for parameter in block.structure.parameters]
    assert table["value"].to_list() == [entry["value"][0] for entry in parameters.values()]


def test_significance_is_told_where_0_has_a_meaning(adjustment) -> None:
    parameters = report_dict(adjustment)["parameters"]
    told = {name for name, entry in parameters.items() if entry["t"] is not None}
    free = {p.name for p in adjustment.block.structure.parameters if p.free}
    assert told == {name for name in free if name.split()[0] in ("shift", "drift", "boresight")}
    (found,) = [finding for finding in findings(adjustment) if finding.kind is Kind.INSIGNIFICANT]
    held = {subject.names[0] for subject in found.subjects}
    assert held and held <= {name for name in told if parameters[name]["t"] < 2}
    assert all(name in found.what for name in held) and found.cure == "fix them at 0"


def with_parameter_cofactors(adjustment, change_of):
    q = np.array(adjustment.cofactors.parameters)
    change_of(q)
    return dataclasses.replace(adjustment, cofactors=adjustment.cofactors._replace(parameters=jnp.asarray(q)))


def test_finds_correlated_parameters(adjustment) -> None:
    a, b = (number(adjustment.block, f"shift {axis} of strip 1") for axis in "XZ")

    def correlate(q: np.ndarray) -> None:
        q[a, b] = q[b, a] = -0.98 * np.sqrt(q[a, a] * q[b, b])

    changed = with_parameter_cofactors(adjustment, correlate)
    (sentence,) = [sentence for sentence in words(changed) if "shift X of strip 1 and shift Z" in sentence]
    assert "by -0.980; fix one of each pair, or give it a value with a sigma" in sentence
    assert "-0.9800" in report_text(changed)
    (pair,) = report_dict(changed)["high_parameter_correlations"]
    assert pair == ["shift X of strip 1", "shift Z of strip 1", pytest.approx(-0.98)]


def test_finds_parameters_without_standard_deviation(adjustment) -> None:
    k = number(adjustment.block, "shift X of strip 1")

    def lose(q: np.ndarray) -> None:
        q[k, k] = np.nan

    changed = with_parameter_cofactors(adjustment, lose)
    (found,) = [finding for finding in findings(changed) if finding.kind is Kind.WEAK]
    assert found.subjects == (Subject("parameters", ("shift X of strip 1",)),)
    assert found.what == "1 parameter without a standard deviation: shift X of strip 1"
    assert report_dict(changed)["parameters"]["shift X of strip 1"]["value"][1] is None


# Tables


def test_all_ends_in_one_table(folder) -> None:
    """Groups between other ends do not overwrite each other."""
    for name, (ends, sigma) in PAIRS.items():
        table = pl.read_csv(folder / f"{name}.csv", infer_schema=False)
        assert sorted(table.select("from", "to").rows()) == sorted(ends)
        np.testing.assert_allclose(table[:, 3].cast(pl.Float64), sigma, rtol=1e-14)


def test_angles_in_the_unit_of_the_folder(adjustment, folder) -> None:
    for name, column in (("azimuths", "azimuth"), ("zenith_angles", "angle"), ("directions", "direction")):
        table = pl.read_csv(folder / f"{name}.csv")
        groups = [(k, g) for k, g in enumerate(adjustment.block.groups) if g.structure.kind.table == name]
        values = np.concatenate([np.asarray(group.values)[:, 0] for _, group in groups])
        residuals = np.concatenate([np.asarray(adjustment.residuals[k + 1])[:, 0] for k, _ in groups])
        np.testing.assert_allclose(table[column], values / GON, rtol=1e-14)
        np.testing.assert_allclose(table[f"v{column}"], residuals / GON, rtol=1e-12)


def test_names_of_what_observations_belong_to(folder) -> None:
    directions = pl.read_csv(folder / "directions.csv")
    assert directions["parameter"][0] == "orientation of set A"
    stations = pl.read_csv(folder / "stations.csv", infer_schema=False)
    assert dict(stations.select("image", "parameters").rows()) == {
        "022": None,
        "011": "strip 1",
        "012": "strip 1",
        "021": "strip 2",
    }
    assert set(pl.read_csv(folder / "planes.csv")["parameters"]) == {"plane roof"}
    assert pl.read_csv(folder / "interior_priors.csv").select("camera", "element", "value").rows() == [
        ("wide", "principal_distance", 50.0)
    ]
    priors = pl.read_csv(folder / "priors.csv")
    assert len(priors) == 6 + sum(sigma > 0 for sigma in BARS.values())
    assert "boresight kappa of strip 1" in priors["parameter"].to_list()


def test_sigmas_from_covariances(adjustment, folder) -> None:
    other = eqx.tree_at(lambda a: a.block.groups[0].sigmas, adjustment, jnp.ones((5 - 1, 3)))
    control = pl.read_csv(folder / "control.csv")
    assert control["sX"].to_list() == pytest.approx([0.02] * 4)
    assert "0.02     0.02     0.03" in report_text(other)


def test_every_file_is_written_once(adjustment, folder) -> None:
    names = files.result_files(adjustment.block)
    assert len(set(names)) == len(names)
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    report = json.loads((folder / "report.json").read_text())
    assert report.pop("files") == names and report.pop("date")
    assert report == json.loads(json.dumps(report_dict(adjustment)))


def test_kinds_of_the_users_own(simple) -> None:
    """Names that the report uses itself, and one name for two kinds."""
    names = [("rays", ("a",)), ("tilts", ("a",)), ("tilts", ("a", "b")), ("parameters", ("value",))]
    touches = ("point",)
    groups = []
    for name, components in names:
        kind = ObservationKind(name, components, touches, lambda point, observed: (point[0],))
        ones = np.ones((1, len(components)))
        groups.append(observation_group(kind, np.zeros((1, 1), int), ones, ones))
    block = dataclasses.replace(simple.block, groups=tuple(groups))
    assert table_names(block) == ["rays_observed", "tilts", "tilts_2", "priors"]


def test_text_fits_the_page_and_counts_parameters(adjustment) -> None:
    text = report_text(adjustment)
    assert text.isascii() and max(map(len, text.splitlines())) <= WIDTH
    free = sum(parameter.free for parameter in adjustment.block.structure.parameters)
    assert f"(images 24, cameras 1, parameters {free}, points " in text
    for title in (
        "Parameters",
        "Zenith angles: computed - observed [gon]",
        "Interior priors: computed - observed",
    ):
        assert f"\n{title}\n" in text
    assert "orientation of set C" in text and "image:022" in text


# Robust weights and free networks


def robust(simple, weights: np.ndarray, settled: bool = True):
    return dataclasses.replace(simple, reweighting=Reweighting("huber", 2.45, 7, jnp.asarray(weights), settled))


def test_robust_weights(simple, tmp_path) -> None:
    structure = simple.block.structure
    weights = np.ones(len(structure.ray_image))
    weights[[3, 8]] = 0.4, 0.02
    low = robust(simple, weights)
    text = report_text(low)
    assert f"Robust weights       huber, limit 2.45; 2 of {len(weights)} rays below 0.5 after 7 rounds" in text
    assert "\nRays with a robust weight below 0.5\n" in text
    names = [
        (structure.image_names[structure.ray_image[ray]], structure.point_names[structure.ray_point[ray]])
        for ray in (8, 3)
    ]
    (sentence,) = [sentence for sentence in words(low) if "robust weight" in sentence]
    assert sentence.startswith("2 rays have a robust weight below 0.5: ")
    assert f"point {names[0][1]} on image {names[0][0]} (0.02), point {names[1][1]}" in sentence
    report = report_dict(low)["robust"]
    assert (report["function"], report["limit"]) == ("huber", 2.45)
    assert report["down_weighted"] == [[*names[0], 0.02], [*names[1], 0.4]]
    table = pl.read_csv(write_report(low, tmp_path / "robust") / "down_weighted.csv", infer_schema=False)
    assert table.columns == ["image", "point", "weight", "vx", "vy"]
    assert table.select("image", "point").rows() == names
    assert "down_weighted.csv" in files.result_files(low.block, True)


def test_robust_weights_that_are_all_believed(simple) -> None:
    low = robust(simple, np.ones(len(simple.block.structure.ray_image)))
    assert not any("robust weight" in sentence for sentence in words(low))
    assert report_dict(low)["robust"]["down_weighted"] == []
    assert "Robust" not in report_text(simple) and "robust" not in report_dict(simple)


def test_robust_weights_that_did_not_settle(simple) -> None:
    unsettled = robust(simple, np.ones(len(simple.block.structure.ray_image)), settled=False)
    assert any(sentence.startswith("the robust weights were still changing after 7") for sentence in words(unsettled))
    assert "7 rounds, which did not converge; 0 rays below 0.5" in unsettled.summary()


def test_a_small_sigma0_of_robust_weights_says_nothing(simple) -> None:
    small = dataclasses.replace(simple, weighted_residuals=tuple(0.5 * v for v in simple.weighted_residuals))
    assert any("sigma0 is" in sentence for sentence in words(small))
    low = robust(small, np.ones(len(simple.block.structure.ray_image)))
    assert not any("sigma0 is" in sentence for sentence in words(low))


@pytest.mark.parametrize("held", [False, True])
def test_free_network(simple, held: bool) -> None:
    """Constraints count in the redundancy unless the elements they stand for are held meanwhile."""
    datum = Datum("inner", (("1_01", "X0"),) if held else (), (), 7)
    structure = dataclasses.replace(simple.block.structure, datum=datum)
    free = dataclasses.replace(
        simple, block=dataclasses.replace(simple.block, structure=structure), redundancy_numbers=None
    )
    text, report = report_text(free), report_dict(free)
    assert "Datum                free network, 7 inner constraints over all object points" in text
    assert report["constraints"] == (0 if held else 7)
    assert report["redundancy"] == simple.redundancy + report["constraints"]
    assert (f"Redundancy M - N + C {free.redundancy}" in text) == (not held)
