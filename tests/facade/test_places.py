"""Places of the fleet's world by their names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from eal_actors.cli.exit_codes import ExitCode, exit_code
from eal_actors.device.world import WorldModel
from eal_actors.facade.fleet import Fleet
from eal_actors.facade.traffic.positions import DEFAULT_RADIUS_M, radius_m_of
from eal_actors.kernel.errors import PlaceNotFoundError
from tests.plugin_files import write_plugin


def fleet_with(places: dict[str, dict[str, float]] | None) -> Fleet:
    fleet = Fleet.load("sim")
    world = None
    if places is not None:
        world = WorldModel.model_validate({"version": 1, "name": "hall", "size_m": [8, 6], "places": places})
    return Fleet(replace(fleet.config, world=world))


def test_a_place_has_a_position_and_may_have_a_heading() -> None:
    fleet = fleet_with({"dock": {"x_m": 3.5, "y_m": 2, "yaw_deg": 90}, "door": {"x_m": -3, "y_m": 0}})
    dock, door = fleet.place("dock"), fleet.place("door")
    assert (dock.x_m, dock.y_m, dock.yaw_deg) == (3.5, 2.0, 90.0)
    assert door.yaw_deg is None


@pytest.mark.parametrize(
    ("places", "name", "message"),
    [
        (
            {"dock": {"x_m": 1, "y_m": 0}, "window": {"x_m": 2, "y_m": 0}},
            "dok",
            "unknown place 'dok'; did you mean 'dock'? Places of 'hall': dock, window",
        ),
        ({"dock": {"x_m": 1, "y_m": 0}}, "xyz", "unknown place 'xyz'. Places of 'hall': dock"),
        ({}, "dock", "no place 'dock': the world 'hall' has no `places`"),
        (None, "dock", "no place 'dock': fleet 'sim' has no world; give its file a `world`"),
    ],
)
def test_an_unknown_place_lists_those_there_are(
    places: dict[str, dict[str, float]] | None, name: str, message: str
) -> None:
    with pytest.raises(PlaceNotFoundError) as caught:
        fleet_with(places).place(name)
    assert str(caught.value) == message
    assert exit_code(caught.value) is ExitCode.BAD_INPUT


ODD_BASE = """
from eal_actors.plugin import EALPlugin, Resource, ResourceType

class Base(Resource):
    types = ResourceType.ACTUATOR

    def send_cmd(self, cmd, data=None):
        return 1

    def get_config(self, key):
        return {radius}
"""


@pytest.mark.parametrize("radius", ["'wide'", "-1.0", "float('nan')", "[0.1, 0.2]"])
def test_a_radius_that_is_none_counts_as_not_told(tmp_path: Path, radius: str) -> None:
    write_plugin(tmp_path, "odd", ODD_BASE.format(radius=radius), "Base")
    (tmp_path / "f.yaml").write_text("version: 1\nplugin_dirs: [plugins]\nrobots: {r: {plugins: {odd: {}}}}\n")
    with Fleet.load(tmp_path / "f.yaml") as fleet:
        assert radius_m_of(fleet["r"]) == DEFAULT_RADIUS_M
