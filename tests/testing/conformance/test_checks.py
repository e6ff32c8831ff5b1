"""Each check finds its mistake: a correct plugin is broken in one place at a time."""

import threading
from dataclasses import replace
from pathlib import Path

import pytest

from eal_actors.cli.plugin import write_plugin
from eal_actors.kernel.errors import ConfigError
from eal_actors.managers.manifest import read_manifest
from eal_actors.managers.plugins import import_plugin
from eal_actors.testing.conformance import (
    CHECKS,
    Bench,
    CheckResult,
    motion_checks,
    run_check,
    run_checks,
    settings_of,
)

INIT = "    def __init__(self) -> None:\n"
STATUS = "        return int(self._moves)\n"
MOVE = "        self._moves = True\n"
SKIPPED = ("estimates its pose", "waits for its device", "survives unplugging")


@pytest.fixture
def slide(tmp_path: Path) -> Path:
    return write_plugin("slide", tmp_path)


def spoil(folder: Path, file: str, before: str, after: str) -> None:
    path = folder / file
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after), encoding="utf-8")


def run(folder: Path, name: str) -> CheckResult:
    (check,) = (check for check in CHECKS if check.name == name)
    return run_check(check, Bench(folder, settings_of({})))


def test_a_good_plugin_passes_every_check(slide: Path) -> None:
    results = list(run_checks(Bench(slide, settings_of({}))))
    assert [(result.check.name, result.outcome, result.problems) for result in results] == [
        (check.name, "skipped", (check.nothing,)) if check.name in SKIPPED else (check.name, "ok", ())
        for check in CHECKS
    ]


MISTAKES = {
    "another name in connect": ("starts", 'EALPlugin("Slide")', 'EALPlugin("Other")', "manifest names Slide"),
    "open fails": ("starts", INIT, f"    def open(self):\n        raise OSError('no port')\n\n{INIT}", "no port"),
    "no type": ("describes itself", "ResourceType.SENSOR | ResourceType.ACTUATOR", "ResourceType(0)", "has no type"),
    "types in words": ("starts", "ResourceType.SENSOR | ResourceType.ACTUATOR", "'sensor'", "Slide: types must be Res"),
    "a value in words": ("starts", "value = _POSITION", "value = 'm'", "Slide: 'm' must be a ValueInfo"),
    "an argument in words": (
        "starts",
        '"to<metres>", _POSITION',
        '"to<metres>", "m"',
        "Slide: 'm' must be a ValueInfo",
    ),
    "a data type in words": ("starts", 'DOUBLE, "m", 0', 'DOUBLE.value, "m", 0', "must be a DataType, such as"),
    "no unit": ("describes itself", 'DOUBLE, "m/s"', "DOUBLE, None", "'speed_m_s' has no unit"),
    "no word about a command": ("describes itself", '"""Move to a position."""', '""', "'to<metres>' has no desc"),
    "an empty range": ("describes itself", "0.01, 0.5", "0.5, 0.01", "empty range: 0.5..0.01"),
    "what JSON cannot hold": ("survives json", '"m", 0, 1)', '"m", 0, 1, choices=(b"x",))', "TypeError"),
    "a method denied": (
        "reports unsupported methods",
        INIT,
        (
            "    def info(self):\n        from dataclasses import replace\n"
            f"        return replace(super().info(), methods=frozenset(['get_value']))\n\n{INIT}"
        ),
        "get_status must fail with UnsupportedError, but succeeded",
    ),
    "a first answer that is late": (
        "answers at once",
        INIT,
        (
            "    looks = 0\n\n    def not_ready(self):\n        self.looks += 1\n"
            f"        return 'no reading yet' if self.looks < 4 else None\n\n{INIT}"
        ),
        "get_value failed: no reading yet; wait for the first answer in `connect`",
    ),
    "text for a number": ("answers", "return self._position_m", "return 'far'", "get_value failed: return_type"),
    "another unit": (
        "answers",
        "return self._position_m",
        "from eal_actors.plugin import EALData\n        return EALData.of(self._position_m, unit='cm')",
        "answer is in cm, declared is m",
    ),
    "a setter that adds": (
        "keeps configuration",
        INIT,
        (
            "    def set_config(self, key, data=None):\n        super().set_config(key, data)\n"
            f"        self.speed_m_s += 0.1\n        return 1\n\n{INIT}"
        ),
        "set to this value",
    ),
    "a config that takes any key": (
        "refuses unknown names",
        INIT,
        f"    def set_config(self, key, data=None):\n        return 1\n\n{INIT}",
        "must fail with ArgumentError, but succeeded",
    ),
    "a config that takes any value": (
        "refuses bad arguments",
        INIT,
        "    def set_config(self, key, data=None):\n        self.speed_m_s = data.value\n        return 1\n\n" + INIT,
        "set_config 'speed_m_s'",
    ),
    "a command without a range check": (
        "refuses bad arguments",
        INIT,
        "    def send_cmd(self, cmd, data=None):\n        return 1\n\n" + INIT,
        "must fail with ArgumentError, but succeeded",
    ),
    "a command that fails": (
        "runs commands",
        MOVE,
        f"        raise OSError('no motor')\n{MOVE}",
        "Slide: send_cmd to1.0 failed: resource_fault: ",
    ),
    "a command that answers text": ("runs commands", MOVE, "        return 'moved'\n", "return_type: "),
    "a stop that fails": (
        "runs commands",
        "def stop(self) -> int:",
        "def stop(self) -> int:\n        raise OSError('no brake')\n\n    def other(self):",
        "Slide: send_cmd s failed: resource_fault: ",
    ),
    "only a command that fails": (
        "stops running commands",
        MOVE,
        f"        raise OSError('no motor')\n{MOVE}",
        "no motor",
    ),
    "no halt": ("can be halted", "def halt(self)", "def stop_it(self)", "does not override halt"),
    "a halt that fails": (
        "can be halted",
        '"""Stop at once."""\n        self._moves = False',
        "raise OSError('brake stuck')",
        "brake stuck",
    ),
    "no status while it moves": (
        "stops running commands",
        STATUS,
        f"        assert not self._moves\n{STATUS}",
        "get_status failed",
    ),
    "usable once": (
        "stops running commands",
        MOVE,
        f"        if hasattr(self, 'used'):\n            return 1\n        self.used = True\n{MOVE}",
        "did not start again",
    ),
    "a status that stays 1": (
        "comes to rest",
        STATUS,
        "        return 1\n",
        "status is 1 before its first command",
    ),
    "a status that a halt keeps": (
        "comes to rest",
        '"""Stop at once."""\n        self._moves = False',
        '"""Stop at once."""',
        "status is not 0 after a halt",
    ),
    "a speed for all": (
        "shares no state",
        "        self.speed_m_s = 0.1\n",
        "        self.__dict__ = _EVERYBODY\n        self.speed_m_s = 0.1\n",
        "of one robot changed the other's",
    ),
    "one object for all": ("shares no state", "return Slide()", "return _ONLY", "have the same object"),
    "a finally that yields": (
        "cleans up",
        "self.halt()  # also on a newer command or a halt",
        "yield 1.0",
        "Slide: close: RuntimeError: generator ignored GeneratorExit",
    ),
    "a destroy that fails": (
        "cleans up",
        '"""Release what `create_Slide` opened: nothing here."""',
        "raise OSError('in use')",
        "Slide: destroy: OSError: in use",
    ),
    "a disconnect that fails": (
        "cleans up",
        '"""Release what `connect` opened: nothing here."""',
        "raise OSError('in use')",
        "PluginError: disconnect failed in slide: OSError: in use",
    ),
    "connects once": ("reconnects", "return EALPlugin(", "_ONCE.pop()\n    return EALPlugin(", "pop from empty list"),
}

GLOBALS = """
_EVERYBODY = {}
_ONCE = [1]
"""


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_found(slide: Path, mistake: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motion_checks, "_REST_S", 0.1)
    name, before, after, words = MISTAKES[mistake]
    spoil(slide, "plugin.py", before, after)
    if "_EVERYBODY" in after or "_ONCE" in after:
        spoil(slide, "plugin.py", "_STEP_S = 0.05\n", f"_STEP_S = 0.05\n{GLOBALS}")
    if "_ONLY" in after:
        spoil(slide, "plugin.py", "def connect()", "_ONLY = Slide()\n\n\ndef connect()")
    result = run(slide, name)
    assert result.outcome == "failed"
    assert words in "\n".join(result.problems)


def test_a_thread_left_behind_is_found_and_named(slide: Path) -> None:
    spoil(
        slide,
        "plugin.py",
        INIT,
        "    def open(self) -> None:\n"
        "        threading.Thread(target=ENOUGH.wait, name='left over', daemon=True).start()\n\n" + INIT,
    )
    spoil(slide, "plugin.py", "_STEP_S = 0.05\n", "import threading\n\nENOUGH = threading.Event()\n_STEP_S = 0.05\n")
    enough = import_plugin(read_manifest(slide)).ENOUGH
    try:
        result = run(slide, "leaves no thread")
    finally:
        enough.set()
        for thread in threading.enumerate():
            if thread.name == "left over":
                thread.join()
    assert result.problems == ("threads are left behind: left over",)


def test_a_command_that_blocks_its_actor_is_told_once_and_the_rest_is_not_waited_for(slide: Path) -> None:
    spoil(slide, "plugin.py", "yield _STEP_S  #", "ENOUGH.wait(0.001)  #")
    spoil(
        slide,
        "plugin.py",
        "            return 1\n        finally",
        "            yield\n            return 1\n        finally",
    )
    spoil(slide, "plugin.py", "step_m = self.speed_m_s * _STEP_S", "step_m = 1e-9")
    spoil(slide, "plugin.py", "_STEP_S = 0.05\n", "import threading\n\nENOUGH = threading.Event()\n_STEP_S = 0.05\n")
    results = list(run_checks(Bench(slide, settings_of({}), timeout_s=0.2)))
    at = next(number for number, result in enumerate(results) if result.check.name == "runs commands")
    assert {result.outcome for result in results[:at]} == {"ok"}
    assert (results[at].outcome, results[at].blocked) == ("failed", "Slide")
    assert results[at].problems == (
        "`Slide: send_cmd to1.0` blocked its actor: make it a generator and yield the seconds instead of sleeping",
    )
    assert {(result.outcome, result.problems) for result in results[at + 1 :]} == {
        ("skipped", ("without Slide, which a command blocked",))
    }


def test_a_resource_that_is_blocked_does_not_keep_the_others_from_their_checks(slide: Path) -> None:
    bench = Bench(slide, settings_of({}), left_out=frozenset({"Other"}))
    with bench.robot() as robot:
        assert list(robot) == ["Slide"]
    with replace(bench, left_out=frozenset({"Slide"})).robot() as robot:
        assert list(robot) == []


def test_a_plugin_that_does_not_come_up_is_not_checked_further(slide: Path) -> None:
    spoil(slide, "plugin.py", "def disconnect(", "def disconnect_it(")
    first, *others = run_checks(Bench(slide, settings_of({})))
    assert first.outcome == "failed"
    assert "lacks the function disconnect()" in first.problems[0]
    assert {result.outcome for result in others} == {"skipped"}


def test_hardware_that_is_there_once_is_not_blamed(slide: Path) -> None:
    spoil(slide, "plugin.py", "_STEP_S = 0.05\n", f"_STEP_S = 0.05\n{GLOBALS}")
    spoil(slide, "plugin.py", "return EALPlugin(", "_ONCE.pop()\n    return EALPlugin(")
    spoil(
        slide, "plugin.py", "def disconnect(plugin: EALPlugin) -> None:", "def disconnect(plugin):\n    _ONCE.append(1)"
    )
    assert run(slide, "shares no state").outcome == "skipped"
    assert run(slide, "reconnects").outcome == "ok"


def test_missing_modules_and_a_namesake_are_told(slide: Path) -> None:
    spoil(slide, "plugin.yaml", "version: 1\n", "version: 1\nrequires: [no_such_module]\n")
    assert "required modules are not installed: no_such_module" in run(slide, "starts").problems
    namesake = write_plugin("a_slide", slide.parent)
    spoil(namesake, "plugin.yaml", "name: a_slide", "name: slide")
    assert f"the plugin in {namesake} has the same name and hides it" in run(slide, "starts").problems


def test_wrong_settings_are_the_user_s_fault_not_the_plugin_s(slide: Path) -> None:
    with pytest.raises(ConfigError, match="settings: nonsense: plugin 'slide' has no settings"):
        run_check(CHECKS[0], Bench(slide, settings_of({"nonsense": 1})))
