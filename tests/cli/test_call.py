"""`eal call`."""

import json
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.bundled import bundled_path
from tests.plugin_files import write_plugin


@pytest.mark.parametrize(
    ("call", "printed"),
    [
        (["get_status"], "0"),
        (["get_value"], "0.0"),
        (["get_config", "speed_m_s"], "0.1"),
        (["set_config", "speed_m_s", "0.2"], "1"),
        (["send_cmd", "s"], "1"),
        (["halt"], "1"),
        (["send_cmd", "to0.01"], "1"),
    ],
)
def test_a_call_prints_what_it_answers(eal: Any, slides: Path, call: list[str], printed: str) -> None:
    result = eal("call", "one", "Slide", *call, "--fleet", slides)
    assert (result.exit_code, result.stdout, result.stderr) == (0, f"{printed}\n", "")


def test_a_value_is_set(eal: Any) -> None:
    fleet = bundled_path("fleets/local.yaml")
    assert eal("call", "local", "SampleResource", "set_value", "-5", "--fleet", fleet).stdout == "1\n"


@pytest.mark.parametrize(("text", "seen"), [("'5'", "'5'"), ("true", "True"), ("4.5", "4.5"), ("five", "'five'")])
def test_arguments_are_yaml_scalars(eal: Any, text: str, seen: str) -> None:
    result = eal("call", "local", "SampleResource", "set_value", text, "-f", bundled_path("fleets/local.yaml"))
    assert result.exit_code == 2
    assert "its value must be int, not" in result.stderr
    assert seen in result.stderr


@pytest.mark.parametrize(
    ("call", "printed"),
    [
        (["set_value", "[0.1, 0]"], "1\n"),
        (["send_cmd", "goto", "[1.6, 0]"], "1\n"),
        (["send_cmd", "follow", "[1.5, 0.1, 1.6, 0.1]"], "1\n"),
    ],
)
def test_an_argument_may_be_a_list(eal: Any, call: list[str], printed: str) -> None:
    result = eal("call", "roomba-1", "Base", *call, "-f", bundled_path("fleets/sim.yaml"))
    assert (result.exit_code, result.stdout, result.stderr) == (0, printed, "")


@pytest.mark.parametrize(
    ("text", "message"), [("[0.1, 0", "a ']' is missing"), ("[0.1, [0]]", "a list of float, list has no type")]
)
def test_a_wrong_list_is_refused(eal: Any, text: str, message: str) -> None:
    result = eal("call", "roomba-1", "Base", "set_value", text, "-f", bundled_path("fleets/sim.yaml"))
    assert result.exit_code == 2
    assert message in result.stderr


def test_json_tells_everything(eal: Any, slides: Path) -> None:
    result = eal("call", "two", "Slide", "get_config", "speed_m_s", "--fleet", slides, "--json")
    answer = json.loads(result.stdout)
    assert answer["robot"] == "two"
    assert (answer["resource"], answer["method"], answer["arguments"]) == ("Slide", "get_config", ["speed_m_s"])
    assert (answer["value"], answer["type"], answer["length"], answer["shape"]) == (0.1, "double", 8, None)


CHATTY = """\
from eal_actors.plugin import EALPlugin, Resource, ResourceType
class Chatty(Resource):
    types = ResourceType.SENSOR
    def get_value(self):
        print("asked")
        return 5
"""


def test_what_a_plugin_prints_is_not_in_the_json(eal: Any, tmp_path: Path, write: Any) -> None:
    write_plugin(tmp_path, "chatty", CHATTY, "Chatty")
    fleet = write("fleet.yaml", "version: 1\nplugin_dirs: [plugins]\nrobots: {one: {plugins: {chatty: {}}}}\n")
    call = ("call", "one", "Chatty", "get_value", "--fleet", fleet)
    result = eal(*call, "--json")
    assert (json.loads(result.stdout)["value"], result.stderr) == (5, "asked\n")
    assert eal(*call).stdout == "asked\n5\n"


def test_arrays_are_printed_whole_while_they_are_short(eal: Any) -> None:
    fleet = bundled_path("fleets/sim.yaml")
    assert eal("call", "roomba-1", "Pose", "get_value", "-f", fleet).stdout == "[1.5, 0.0, 0.0]\n"
    angles = eal("call", "roomba-1", "Range", "send_req", "angles", "-f", fleet).stdout
    assert angles.startswith("[0.0, ")
    assert angles.endswith("] rad\n")
    image = eal("call", "roomba-1", "Camera", "get_value", "-f", fleet)
    assert image.stdout == "480 x 640 x 3 char; --json prints every element\n"
    whole = json.loads(eal("call", "roomba-1", "Camera", "get_value", "-f", fleet, "--json").stdout)
    assert whole["shape"] == [480, 640, 3]
    assert [len(whole["value"]), len(whole["value"][0]), len(whole["value"][0][0])] == [480, 640, 3]
    assert eal("call", "roomba-1", "Bump", "send_req", "left", "-f", fleet).stdout == "false\n"


@pytest.mark.parametrize(
    ("call", "code", "words"),
    [
        (["one", "Slide", "get_vaule"], 2, "did you mean 'get_value'"),
        (["one", "Slide", "send_cmd"], 2, "send_cmd takes COMMAND [DATA], not none"),
        (["one", "Slide", "get_value", "5"], 2, "get_value takes no argument"),
        (["one", "Slide", "set_config", "speed_m_s"], 2, "set_config takes KEY VALUE"),
        (["one", "Slide", "get_value", "--timout-s"], 2, "no such option: --timout-s"),
        (["one", "Slide", "read_comm", "many"], 2, "needs a number of bytes"),
        (["one", "Slide", "set_value", ".inf"], 2, "not a finite number"),
        (["three", "Slide", "get_value"], 2, "has no robot 'three'; known: one, two"),
        (["one", "Slide", "send_req", "x"], 2, "does not support send_req"),
        (["one", "Slide", "set_config", "speed_m_s", "-5"], 2, "double 0.01..0.5 m/s, not -5"),
        (["one", "Slide", "send_cmd", "to1", "--timeout-s", "0.05"], 1, "no answer within its 0.05 s"),
    ],
)
def test_what_cannot_be_called_is_told(eal: Any, slides: Path, call: list[str], code: int, words: str) -> None:
    result = eal("call", *call, "--fleet", slides)
    assert result.exit_code == code
    assert words in " ".join(result.stderr.split())
    assert result.stdout == ""


def test_only_the_wanted_robot_is_connected(eal: Any, half_dead: Path) -> None:
    result = eal("call", "one", "Slide", "get_value", "--fleet", half_dead)
    assert (result.exit_code, result.stderr) == (0, "")
    lost = eal("call", "lost", "Slide", "get_value", "--fleet", half_dead)
    assert lost.exit_code == 3
    assert "Error: lost: none of its plugins connected" in lost.stderr
    assert "plugin 'dead': connect raised OSError: no such port" in lost.stderr
