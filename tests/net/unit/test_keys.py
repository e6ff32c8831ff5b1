from __future__ import annotations

import re

import pytest
import zenoh
from hypothesis import example, given
from hypothesis import strategies as st

from eal_actors.errors import ProtocolError
from eal_actors.net import keys
from eal_actors.strict_model import NAME_PATTERN

ANY_TEXT = st.text(st.characters(), min_size=1)  # lone surrogates too, as in names of files
NAMES = st.from_regex(re.compile(NAME_PATTERN, re.ASCII), fullmatch=True).map(lambda name: name.rstrip("\n"))


@pytest.mark.parametrize(
    ("names", "key"),
    [
        pytest.param(("lab", "evbot2-1", "Sonar", "get_value"), "eal/lab/evbot2-1/Sonar/get_value", id="plain"),
        pytest.param(("lab", "r.2_a", "arm.Gripper", "send_cmd"), "eal/lab/r.2_a/arm.Gripper/send_cmd", id="dots"),
        pytest.param(("lab", "r1", "_", "hello"), "eal/lab/r1/_/hello", id="the robot itself"),
        pytest.param(("my lab #2", "r1", "S", "halt"), "eal/my%20lab%20%232/r1/S/halt", id="space and #"),
        pytest.param(("a/b*$@?%", "r1", "S", "info"), "eal/a%2Fb%2A%24%40%3F%25/r1/S/info", id="zenoh's own signs"),
        pytest.param(("Büro", "r1", "S", "info"), "eal/B%C3%BCro/r1/S/info", id="UTF-8"),
        pytest.param(("\udcff", "r1", "S", "info"), "eal/%ED%B3%BF/r1/S/info", id="file name that is no UTF-8"),
    ],
)
def test_names_and_keys_belong_together(names: tuple[str, str, str, str], key: str) -> None:
    assert keys.method_key(*names) == key
    assert keys.parse_method(key) == names
    assert key.startswith(keys.robot_key(*names[:2]) + "/")


@given(ANY_TEXT, NAMES, NAMES, st.sampled_from(keys.RESOURCE_METHODS))
@example("**", "r", "R", "halt")
@example("@", "r", "R", "halt")
def test_every_key_is_one_for_zenoh_and_reads_back(fleet: str, robot: str, resource: str, method: str) -> None:
    key = keys.method_key(fleet, robot, resource, method)
    assert keys.parse_method(key) == (fleet, robot, resource, method)
    assert robot in key  # names of robots and resources stand as they are
    assert resource in key
    own = zenoh.KeyExpr(f"{keys.robot_key(fleet, robot)}/**")
    assert own.includes(zenoh.KeyExpr(key))
    assert not own.intersects(keys.method_key(fleet, robot + "x", resource, method))
    assert not own.intersects(keys.method_key(fleet + "x", robot, resource, method))


@given(st.text())
@example("eal/%FF/r/S/halt")
@example("eal/lab//S/halt")
def test_a_key_is_spelt_one_way_or_refused(key: str) -> None:
    try:
        names = keys.parse_key(key)
    except ProtocolError:
        return
    assert keys.method_key(*names) == key


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("eal/lab/r1/Sonar", "is not eal/<fleet>/<robot>/<resource>/<method>"),
        ("eal/lab/r1/Sonar/get_value/x", "is not eal/<fleet>/<robot>/<resource>/<method>"),
        ("elsewhere/lab/r1/Sonar/get_value", "is not eal/<fleet>/<robot>/<resource>/<method>"),
        ("eal/lab/r1//get_value", "'' is not how a name is spelt"),
        ("eal/lab/r1/Son%61r/get_value", "'Son%61r' is not how a name is spelt"),
        ("eal/a%2fb/r1/Sonar/get_value", "'a%2fb' is not how a name is spelt"),
        ("eal/%FF/r1/Sonar/get_value", "'%FF' is no percent-encoded UTF-8"),
        ("eal/lab/r1/Sonar/explode", "there is no method 'explode' here; there are get_status, get_value"),
        ("eal/lab/r1/Sonar/stop", "there is no method 'stop' here"),
        ("eal/lab/r1/_/get_value", "there is no method 'get_value' here; there are hello, ping"),
        ("eal/lab/_/heartbeat/0123456789abcdef", "there is no method '0123456789abcdef' here"),
        ("eal/lab/_/S/get_value", "there is no method"),
    ],
)
def test_what_means_no_method_is_refused(key: str, message: str) -> None:
    with pytest.raises(ProtocolError, match=re.escape(message)):
        keys.parse_method(key)


@pytest.mark.parametrize("names", [("", "r", "S", "halt"), ("f", "", "S", "halt"), ("f", "r", "", "halt")])
def test_an_empty_name_has_no_key(names: tuple[str, str, str, str]) -> None:
    with pytest.raises(ProtocolError, match="empty name"):
        keys.method_key(*names)


@given(ANY_TEXT, NAMES)
def test_expressions_find_what_they_are_for(fleet: str, robot: str) -> None:
    client = "0123456789abcdef"
    alive = keys.method_key(fleet, robot, keys.ROBOT, keys.ALIVE)
    beat = keys.heartbeat_key(fleet, client)
    assert zenoh.KeyExpr(keys.alive_keys(fleet)).includes(alive)
    assert zenoh.KeyExpr(keys.heartbeat_keys(fleet)).includes(beat)
    assert keys.parse_key(alive) == (fleet, robot, "_", "alive")
    assert keys.parse_key(beat) == (fleet, "_", "heartbeat", client)
    assert not zenoh.KeyExpr(f"{keys.robot_key(fleet, robot)}/**").intersects(beat)
