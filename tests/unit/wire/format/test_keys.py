from __future__ import annotations

import re
from collections.abc import Callable

import pytest
import zenoh
from hypothesis import example, given
from hypothesis import strategies as st

from eal_actors.kernel.errors import ProtocolError
from eal_actors.kernel.strict_model import NAME_PATTERN
from eal_actors.wire.format import keys
from eal_actors.wire.format.keys import CallKey
from eal_actors.wire.format.packing import PROTOCOL_VERSION

ANY_TEXT = st.text(st.characters(), min_size=1)  # lone surrogates too, as in names of files
NAMES = st.from_regex(re.compile(NAME_PATTERN, re.ASCII), fullmatch=True).map(lambda name: name.rstrip("\n"))


CLIENT = 2 * "0123456789abcdef"


@pytest.mark.parametrize(
    ("names", "key"),
    [
        pytest.param(("lab", "evbot2-1", "Sonar", "get_value", "_"), "eal/lab/evbot2-1/Sonar/get_value/_", id="plain"),
        pytest.param(("lab", "r.2_a", "arm.Grip", "send_cmd", "a.b"), "eal/lab/r.2_a/arm.Grip/send_cmd/a.b", id="dots"),
        pytest.param(("lab", "r1", "_", "hello", "desk"), "eal/lab/r1/_/hello/desk", id="the robot itself"),
        pytest.param(("my lab #2", "r1", "S", "halt", "_"), "eal/my%20lab%20%232/r1/S/halt/_", id="space and #"),
        pytest.param(
            ("a/b*$@?%", "r1", "S", "halt", "_"), "eal/a%2Fb%2A%24%40%3F%25/r1/S/halt/_", id="zenoh's own signs"
        ),
        pytest.param(("Büro", "r1", "S", "halt", "_"), "eal/B%C3%BCro/r1/S/halt/_", id="UTF-8"),
        pytest.param(("\udcff", "r1", "S", "halt", "_"), "eal/%ED%B3%BF/r1/S/halt/_", id="file name that is no UTF-8"),
    ],
)
def test_names_and_keys_belong_together(names: tuple[str, str, str, str, str], key: str) -> None:
    call = CallKey(*names, CLIENT)
    assert keys.call_key(call) == f"{key}/{CLIENT}"
    assert keys.parse_route(f"{key}/{CLIENT}").call == call


@given(ANY_TEXT, NAMES, NAMES, st.sampled_from(keys.RESOURCE_METHODS), NAMES)
@example("**", "r", "R", "halt", "c")
@example("@", "r", "R", "halt", "c")
def test_every_key_is_one_for_zenoh_and_reads_back(
    fleet: str, robot: str, resource: str, method: str, caller: str
) -> None:
    call = CallKey(fleet, robot, resource, method, caller, CLIENT)
    key = keys.call_key(call)
    assert keys.parse_route(key).call == call
    assert robot in key  # names of robots and resources stand as they are
    assert resource in key
    own = zenoh.KeyExpr(keys.call_keys(fleet, robot))
    assert own.includes(zenoh.KeyExpr(key))
    assert zenoh.KeyExpr(keys.call_keys(fleet, None)).includes(own)
    assert not own.intersects(keys.call_key(call._replace(robot=robot + "x")))
    assert not own.intersects(keys.call_key(call._replace(fleet=fleet + "x")))
    answer = keys.answer_key(fleet, caller, CLIENT, robot)
    assert keys.parse_robot(answer) == (fleet, robot)
    assert zenoh.KeyExpr(keys.answer_key(fleet, caller, CLIENT, None)).includes(answer)
    assert not zenoh.KeyExpr(keys.answer_key(fleet, caller + "x", CLIENT, None)).intersects(answer)


@given(st.text())
@example("eal/%FF/r/S/halt/_/c")
@example("eal/lab//S/halt/_/c")
def test_a_key_is_spelt_one_way_or_refused(key: str) -> None:
    try:
        call = keys.parse_route(key).call
    except ProtocolError:
        return
    assert keys.call_key(call) == key


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("eal/lab/r1/Sonar/get_value/_", "is not eal/<fleet>/<robot>/<resource>/<method>/<caller>/<client>"),
        ("eal/lab/r1/Sonar/get_value/_/c/x", "is not eal/<fleet>/<robot>/<resource>/<method>/<caller>/<client>"),
        ("elsewhere/lab/r1/Sonar/get_value/_/c", "is not eal/<fleet>/<robot>/<resource>/<method>/<caller>/<client>"),
        ("eal/lab/r1//get_value/_/c", "'' is not how a name is spelt"),
        ("eal/lab/r1/Son%61r/get_value/_/c", "'Son%61r' is not how a name is spelt"),
        ("eal/lab/*/Sonar/get_value/_/c", "'*' is not how a name is spelt"),
        ("eal/a%2fb/r1/Sonar/get_value/_/c", "'a%2fb' is not how a name is spelt"),
        ("eal/%FF/r1/Sonar/get_value/_/c", "'%FF' is no percent-encoded UTF-8"),
        ("eal/lab/r1/Sonar/explode/_/c", "there is no method 'explode' here; there are get_status, get_value"),
        ("eal/lab/r1/Sonar/stop/_/c", "there is no method 'stop' here"),
        ("eal/lab/r1/_/get_value/_/c", "there is no method 'get_value' here; there are hello, ping"),
        ("eal/lab/@answers/_/ping/_/c", "'@answers' is not how a name is spelt"),
    ],
)
def test_what_means_no_call_is_refused(key: str, message: str) -> None:
    with pytest.raises(ProtocolError, match=re.escape(message)):
        keys.parse_route(key)


def test_the_reply_to_each_call_of_a_batch_goes_to_its_own_robot() -> None:
    first = CallKey("lab", "r1", "Eye", "get_value", "_", CLIENT)
    for robot in ("r1", "r2"):
        route = keys.route_in_batch(keys.call_key(first), robot, "Arm", "send_cmd")
        assert route == keys.parse_route(keys.call_key(first._replace(robot=robot, resource="Arm", method="send_cmd")))
        assert keys.parse_robot(route.answer_key) == ("lab", robot)


@pytest.mark.parametrize("names", [("", "r", "S", "halt"), ("f", "", "S", "halt"), ("f", "r", "", "halt")])
def test_an_empty_name_has_no_key(names: tuple[str, str, str, str]) -> None:
    with pytest.raises(ProtocolError, match="empty name"):
        keys.call_key(CallKey(*names, "_", CLIENT))


@given(ANY_TEXT, NAMES, NAMES)
def test_what_is_told_stands_apart_from_calls(fleet: str, robot: str, resource: str) -> None:
    told = {
        keys.alive_key(fleet, robot): keys.alive_key(fleet, None),
        keys.event_key(fleet, robot): keys.event_key(fleet, None),
        keys.server_key(fleet, robot, "a1", "anna@pc (pid 7)"): keys.server_key(fleet, robot, None, None),
        keys.heartbeat_key(fleet, robot, CLIENT): keys.heartbeat_key(fleet, None, None),
        keys.stream_key(fleet, robot, resource, "raw", "12.5"): None,
    }
    calls = zenoh.KeyExpr(keys.call_keys(fleet, None))
    for key, expression in told.items():
        assert not calls.intersects(key)
        assert expression is None or zenoh.KeyExpr(expression).includes(key)
    assert zenoh.KeyExpr(keys.ALL_ALIVE).includes(keys.alive_key(fleet, robot))
    assert keys.parse_alive(keys.alive_key(fleet, robot)) == (fleet, robot, PROTOCOL_VERSION)
    assert keys.parse_robot(keys.event_key(fleet, robot)) == (fleet, robot)


@pytest.mark.parametrize(
    "key", ["eal/lab", "elsewhere/lab/@alive/r", "eal/lab/@alive/", "eal/%FF/@alive/r", "eal/l/@alive/*"]
)
def test_what_names_no_robot_is_refused(key: str) -> None:
    with pytest.raises(ProtocolError):
        keys.parse_robot(key)


def test_a_heartbeat_names_its_sender() -> None:
    assert keys.heartbeat_key("my lab", "a.b", "c1") == "eal/my%20lab/@heartbeats/a.b/c1"
    assert keys.parse_heartbeat("eal/my%20lab/@heartbeats/a.b/c1") == ("a.b", "c1")
    for key in ("eal/f/@heartbeats/c1", "eal/f/@heartbeats/a/b/c", "eal/f/@events/a/b", "x/f/@heartbeats/a/b"):
        with pytest.raises(ProtocolError, match="is not eal/<fleet>/@heartbeats/<caller>/<client>"):
            keys.parse_heartbeat(key)


def test_a_server_s_token_names_its_process() -> None:
    key = keys.server_key("my lab", "r1", "a1", "anna@pc (pid 7)")
    assert key == "eal/my%20lab/@servers/r1/a1/anna%40pc%20%28pid%207%29"
    assert keys.parse_server(key) == ("r1", "a1", "anna@pc (pid 7)")
    for key in ("eal/f/@servers/r1/a1", "eal/f/@servers/r1/a1/b/c", "eal/f/@events/r1/a1/b", "x/f/@servers/r1/a1/b"):
        with pytest.raises(ProtocolError, match="is not eal/<fleet>/@servers/<robot>/<process>/<name>"):
            keys.parse_server(key)


@pytest.mark.parametrize("parse", [keys.parse_route, keys.parse_heartbeat, keys.parse_server])
def test_a_long_key_is_not_read(parse: Callable[[str], object]) -> None:
    with pytest.raises(ProtocolError, match="a key of 1025 characters, more than 1024"):
        parse("x" * 1025)


def test_the_published_identifier_belongs_to_a_certificate_and_hides_the_client() -> None:
    ours, ours_again, theirs = keys.client_id("a", "s1"), keys.client_id("a", "s2"), keys.client_id("b", "s1")
    assert keys.certificate_id(ours) == keys.certificate_id(ours_again) != keys.certificate_id(theirs)
    assert len({ours[16:], ours_again[16:], theirs[16:]}) == 3
    assert keys.client_id("a/b", "c") != keys.client_id("a", "b/c")


def test_the_token_s_key_is_what_it_was_and_tells_the_version() -> None:
    assert keys.alive_key("lab", "r1") == f"eal/lab/@alive/{PROTOCOL_VERSION}/r1"
    assert keys.parse_alive("eal/my%20lab/@alive/17/r1") == ("my lab", "r1", 17)
    assert zenoh.KeyExpr(keys.alive_key("lab", None)).includes("eal/lab/@alive/17/r1")


@pytest.mark.parametrize(
    "key",
    [
        "eal/lab/@alive/r1",
        "eal/lab/@alive/x/r1",
        "eal/lab/@alive/-1/r1",
        "eal/lab/@alive/٣/r1",
        "eal/lab/@alive/3/4/r1",
        "eal/lab/@events/3/r1",
        "eal/lab/@alive/3/",
    ],
)
def test_what_is_no_token_s_key_is_refused(key: str) -> None:
    with pytest.raises(ProtocolError):
        keys.parse_alive(key)
