"""Behind a router, a certificate speaks for itself alone: nobody answers, reports or lives in a robot's name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.wire import session
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import CallReply, RobotEvent, encode_event, encode_reply
from tests.net.links import eventually
from tests.security.forging import RawClient, raw_client
from tests.security.test_revocation import RoutedSite, routed  # noqa: F401  # a fixture

FORGERS = "mate", "display"


@contextmanager
def clients(site: RoutedSite) -> Iterator[dict[str, RawClient]]:
    """Serve the robot behind the router, and link its controller and the forgers to that."""
    with ExitStack() as stack:
        stack.enter_context(site.serve())
        names = "controller", *FORGERS
        yield {name: stack.enter_context(raw_client(site.rig.config, name)) for name in names}


def forge(forger: RawClient, target: RawClient) -> None:
    """Speak as the robot: answer the target's next call, end its command, send a value, and live as other robots."""
    answer = encode_reply(CallReply(target.sequence + 1, 99))
    forger.publish(keys.answer_key("f", target.name, target.secret, "r1"), bytes(answer[1]), answer[0])
    event = encode_event(RobotEvent("state", REAL_TIME.now(), fields={"state": "failed"}))
    forger.publish(keys.event_key("f", "r1"), bytes(event[1]), event[0])
    forger.publish("eal/f/@streams/r1/Gauge/raw/5", b"forged")
    for token in (keys.alive_key("f", "r2"), keys.server_key("f", "r1", "forged", "another")):
        forger.session.liveliness().declare_token(token)
    forger.ping()


@contextmanager
def hearing(client: RawClient) -> Iterator[list[str]]:
    """Collect what comes in a robot's name."""
    heard: list[str] = []
    with ExitStack() as stack:
        for key in ("eal/f/@events/*", "eal/f/@streams/**"):
            stack.enter_context(
                client.session.declare_subscriber(key, lambda sample: heard.append(str(sample.key_expr)))
            )
        for key in (keys.alive_key("f", None), keys.server_key("f", "r1", None, None)):
            tokens = client.session.liveliness()
            stack.enter_context(tokens.declare_subscriber(key, lambda sample: heard.append(str(sample.key_expr))))
        yield heard


def test_nobody_speaks_for_a_robot_behind_a_router(routed: RoutedSite) -> None:  # noqa: F811
    with clients(routed) as linked, hearing(linked["controller"]) as heard:
        controller = linked["controller"]
        controller.ping()
        for name in FORGERS:
            forge(linked[name], controller)
        assert controller.call("Arm", "get_status") == 0
        controller.ping()
        assert heard == []


def test_without_access_control_of_the_router_they_are_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """The proof that these are attacks: the same ends, with that check alone left out."""

    def permit_all(*_: object) -> dict[str, Any]:
        return {"enabled": False}

    monkeypatch.setattr(session, "router_access", permit_all)
    with clients(request.getfixturevalue("routed")) as linked, hearing(linked["controller"]) as heard:
        controller = linked["controller"]
        controller.ping()
        forge(linked["display"], controller)
        assert controller.call("Arm", "get_status") == 99
        assert eventually(lambda: {key.split("/")[2] for key in heard} == {"@events", "@streams", "@alive", "@servers"})
