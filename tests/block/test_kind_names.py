"""Kinds of observation are told apart by their names: no two that may stand in one block share one."""

import dataclasses
import importlib
import pkgutil
from collections.abc import Iterator

import numpy as np
import pytest
from cases.all_observations import navigation, strip

import jaxbundle.block
from jaxbundle.block.block import Block
from jaxbundle.block.geodetic import _BETWEEN, geodetic_kind
from jaxbundle.block.navigation import ATTITUDES, GNSS_STATIONS
from jaxbundle.block.observation_kinds import CONTROL, STATIONS, ObservationKind, interior_priors, observation_group
from jaxbundle.statistics.subsets import observations_of_kind


def _kinds() -> Iterator[ObservationKind]:
    """Kinds that the package offers; attitudes of one rotation system, since a block has one."""
    for found in pkgutil.iter_modules(jaxbundle.block.__path__):
        for value in vars(importlib.import_module(f"jaxbundle.block.{found.name}")).values():
            if isinstance(value, ObservationKind):
                yield value
    yield from (geodetic_kind(name) for name in _BETWEEN)
    yield ATTITUDES["omega-phi-kappa"]
    yield interior_priors(("c",))


def test_no_two_kinds_share_a_name():
    by_name: dict[str, set[ObservationKind]] = {}
    for kind in _kinds():
        by_name.setdefault(kind.name, set()).add(kind)
    assert len(by_name) >= 15
    assert not {name for name, kinds in by_name.items() if len(kinds) > 1}
    assert {kind.touches for kind in ATTITUDES.values()} == {ATTITUDES["omega-phi-kappa"].touches}


def test_stations_with_and_without_systematic_errors_are_two_kinds_of_one_table():
    assert STATIONS.name != GNSS.name
    assert STATIONS.table == GNSS.table == "stations"
    assert CONTROL.table == "control"


def test_a_subset_has_one_of_them():
    block = _with_plain_station(navigation(strip()))
    plain, gnss = (observations_of_kind(block, kind.name) for kind in (STATIONS, GNSS_STATIONS))
    number = {group.structure.kind: k for k, group in enumerate(block.groups, 1)}
    assert plain.count == 3 and gnss.count > 3
    assert plain.masks[number[STATIONS]].all() and not plain.masks[number[GNSS]].any()
    assert gnss.masks[number[GNSS]].any() and not gnss.masks[number[STATIONS]].any()


def _with_plain_station(block: Block) -> Block:
    groups = [group for group in block.groups if group.structure.kind != STATIONS]
    centre = np.asarray(block.exterior.projection_centre)[:1]
    station = observation_group(STATIONS, np.array([[0]]), centre, np.full((1, 3), 0.1))
    return dataclasses.replace(block, groups=(*groups, station))


def test_interior_elements_of_all_camera_models_are_meant():
    block = strip()
    one, other = (
        observation_group(interior_priors(names), np.array([[0]]), np.ones((1, len(names))), np.ones((1, len(names))))
        for names in (("c", "x0"), ("c", "K1", "K2"))
    )
    block = dataclasses.replace(block, groups=(one, other))
    assert observations_of_kind(block, "interior").count == 5
    assert observations_of_kind(block, "interior", ["K1"]).count == 1
    with pytest.raises(ValueError, match="no component 'K3'; there are c, x0, K1, K2"):
        observations_of_kind(block, "interior", ["K3"])
