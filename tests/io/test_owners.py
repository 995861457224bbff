"""The owner of a parameter is a field of its own: the name of the parameter may be any text."""

import dataclasses

from cases import all_observations

from jaxbundle.block.block import Owner, Parameter
from jaxbundle.block.navigation import GNSS_STATIONS
from jaxbundle.report.group_tables import member_names
from jaxbundle.statistics.possible_errors import _sharing


def test_an_owner_in_words():
    assert Owner("planes", "roof").words == "plane roof"
    assert Owner("navigation", "strip 1").words == "strip 1"
    assert Parameter("a", owner=Owner("planes", "roof")) == Parameter("a")


def test_groups_are_called_by_their_owner():
    block = all_observations.navigation(all_observations.strip())
    group = next(g for g in block.groups if g.structure.kind == GNSS_STATIONS)
    touched = set(group.structure.indices[:, 1:].ravel().tolist())
    parameters = tuple(
        dataclasses.replace(
            p, name=f"number {k} of none", owner=Owner("navigation", "flight of May") if k in touched else None
        )
        for k, p in enumerate(block.structure.parameters)
    )
    block = dataclasses.replace(block, structure=dataclasses.replace(block.structure, parameters=parameters))
    assert _sharing(block, group)[0][0] == "flight of May"
    assert set(member_names(block.structure, group)["parameters"]) == {"flight of May"}
