"""The configuration and the limits of an EvBot II's base."""

from __future__ import annotations

import math

import pytest

from eal_actors.kernel.errors import ArgumentError
from eal_actors.plugin import EALData
from tests.unit.plugins.evbot2.rig import STEP_M, Rig, sent_verbs


def test_its_configuration_holds_for_later_commands() -> None:
    rig = Rig()
    for key, value in (("speed_m_s", 0.1), ("turn_rate_deg_s", 20.0), ("step_m", 0.2)):
        rig.base.set_config(key, EALData.of(value))
        assert rig.base.get_config(key) == value
    begun_s = rig.clock.now()
    rig.do("g")
    assert 2.0 < rig.clock.now() - begun_s < 3.2
    begun_s = rig.clock.now()
    rig.do("r")
    assert 4.5 < rig.clock.now() - begun_s < 5.5
    assert rig.body.pose[0] == pytest.approx(0.2, abs=2 * STEP_M)


@pytest.mark.parametrize(
    ("key", "value"), [("speed_m_s", 0.41), ("speed_m_s", 0.0), ("turn_rate_deg_s", 121.0), ("wheelbase_m", 0.3)]
)
def test_what_the_make_does_not_reach_is_refused_before_anything_is_sent(key: str, value: float) -> None:
    rig = Rig()
    sent_verbs(rig)
    with pytest.raises(ArgumentError):
        rig.base.set_config(key, EALData.of(value))
    assert sent_verbs(rig) == []


@pytest.mark.parametrize("twist", [[0.41, 0.0], [0.0, 2.1], [math.nan, 0.0], [0.0, math.inf]])
def test_a_twist_that_it_does_not_reach_is_refused_before_anything_is_sent(twist: list[float]) -> None:
    rig = Rig()
    sent_verbs(rig)
    with pytest.raises(ArgumentError, match="which the evbot2 reaches"):
        rig.run(rig.base.set_value(EALData.of(twist)))
    assert sent_verbs(rig) == []
