"""A camera says of itself what the simulated one says, so that one controller fits both."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from eal_actors.plugin import EALData, FleetServices, PluginContext, Resource, ResourceInfo
from plugins.sim import plugin as sim
from tests.manual_clock import ManualClock
from tests.unit.plugins.camera.rig import PATIENCE_S, camera_on, run, write_folder

ONLY_SIMULATED = {"noise"}
"""A real camera has the noise that it has."""

ONLY_REAL = {"fps", "format"}
"""A simulated camera takes its pictures when it is asked, and as arrays."""


def simulated_camera() -> Resource:
    settings = sim.Settings.model_validate({"model": "evbot2"})
    context = PluginContext("rob", "twin", settings, FleetServices(ManualClock()))
    camera = sim.connect(context).makers["Camera"]()
    camera.name = "Camera"

    return camera


def common(info: ResourceInfo, own: set[str]) -> ResourceInfo:
    """Return what is to be the same: all but the keys of its own, and what it is in the words of its kind."""
    assert own <= {key.name for key in info.configs}
    configs = sorted((key for key in info.configs if key.name not in own), key=lambda key: key.name)
    return replace(info, configs=tuple(configs), description="")


def test_it_says_the_same_of_itself(tmp_path: Path) -> None:
    with camera_on({"source": str(write_folder(tmp_path, range(2)))}) as camera:
        assert common(camera.info(), ONLY_REAL) == common(simulated_camera().info(), ONLY_SIMULATED)


def test_it_has_the_same_camera_matrix(tmp_path: Path) -> None:
    simulated = simulated_camera()
    settings = {"source": str(write_folder(tmp_path, range(2))), "loop": True, "fov_deg": 70, "timeout_s": PATIENCE_S}
    with camera_on(settings) as camera:
        for key, value in (
            ("width", run(camera.width())),
            ("height", run(camera.height())),
            ("fov_deg", camera.fov_deg()),
        ):
            simulated.set_config(key, EALData.of(value))
        assert np.array_equal(simulated.send_req("intrinsics").value, run(camera.send_req("intrinsics")).value)


def test_a_picture_is_of_the_same_form(tmp_path: Path) -> None:
    simulated = simulated_camera()
    for key, value in (("width", 64), ("height", 48)):
        simulated.set_config(key, EALData.of(value))
    settings = {"source": str(write_folder(tmp_path, range(2))), "loop": True, "fps": 50, "timeout_s": PATIENCE_S}
    with camera_on(settings) as camera:
        one, other = simulated.get_value(), run(camera.get_value())
    assert (one.type, one.shape, one.frame_id, one.unit) == (other.type, other.shape, other.frame_id, other.unit)
