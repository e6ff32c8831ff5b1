"""The example of docs that talks to a device without a driver, with a real UDP socket as the device."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import Run, load_scenario, make_plan


def test_a_device_is_asked_in_its_own_words_and_its_answer_is_saved(tmp_path: Path) -> None:
    scenario = load_scenario(bundled_path("docs/examples/ask_device.yaml"))
    with socket.socket(type=socket.SOCK_DGRAM) as device:
        device.bind(("127.0.0.1", 0))
        device.settimeout(60)
        asked: list[bytes] = []

        def answer() -> None:
            question, sender = device.recvfrom(100)
            asked.append(question)
            device.sendto(b"21.5 C", sender)

        thread = threading.Thread(target=answer)
        thread.start()
        settings = {"host": "127.0.0.1", "port": device.getsockname()[1], "protocol": "udp", "timeout_s": 60}
        robots = {"oven": {"plugins": {"socket_port": settings}, "timeout_s": 60}}
        config = EALConfigManager.of({"version": 1, "name": "kitchen", "robots": robots}, name="kitchen").fleet
        with Fleet(config).connect() as fleet:
            report = Run(make_plan(scenario, fleet), fleet, tmp_path / "run").start().get(timeout=60)
        thread.join(60)
    assert report.outcome == "done", report
    assert asked == [b"temperature?"]
    assert (tmp_path / "run/oven/answer.txt").read_text(encoding="utf-8").strip() == "21.5 C"
