from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from eal_actors.kernel.errors import ConfigError
from evbotos.definitions import load_definitions
from evbotos.model import Local
from evbotos.robot_files import access_files
from evbotos.wireless import Wifi, WirelessNetwork, configuration
from tests.evbotos.proof import SERVES, answer, built_proof, started, wait_for_words

LOCAL = """version: 1
wifi:
  country: DE
  networks:
    - {name: Lab, passphrase: correct "horse"}
    - {name: Café, hidden: true}
"""
JOINED = """ctrl_interface=/run/wpa_supplicant
update_config=1
country=DE
network={
    ssid=436166c3a9
    scan_ssid=1
    priority=0
    key_mgmt=NONE
    bgscan="simple:30:-65:300"
}
network={
    ssid=4c6162
    scan_ssid=0
    priority=1
    key_mgmt=WPA-PSK SAE
    ieee80211w=1
    psk="correct "horse""
    bgscan="simple:30:-65:300"
}
"""


def test_networks_of_local_yaml_are_among_the_robots_files(tmp_path: Path) -> None:
    local = tmp_path / "local.yaml"
    local.write_text(LOCAL)
    settings = load_definitions(local).local
    assert access_files(settings) == {"wifi.conf": JOINED.encode()}
    assert access_files(Local(version=1)) == {}


def test_the_first_network_is_the_best() -> None:
    names = [WirelessNetwork(name=name) for name in ("one", "two", "three")]
    text = configuration(Wifi(country="FR", networks=tuple(names)))
    assert text.index(f"ssid={b'one'.hex()}\n    scan_ssid=0\n    priority=2") > 0


@pytest.mark.parametrize(
    ("changed", "to", "told"),
    [
        ("country: DE", "country: de", "local.yaml:3:12: wifi.country"),
        ("country: DE", "land: DE", "local.yaml:3:3: wifi.land"),
        ('correct "horse"', "short", "local.yaml:5:31: wifi.networks[0].passphrase"),
        ("name: Lab", f"name: {33 * 'x'}", "local.yaml:5:14: wifi.networks[0].name"),
        ('correct "horse"', '"two\\nlines of it"', "wifi.networks[0].passphrase"),
    ],
)
def test_wrong_settings_are_told_with_their_place(tmp_path: Path, changed: str, to: str, told: str) -> None:
    local = tmp_path / "local.yaml"
    local.write_text(LOCAL.replace(changed, to))
    with pytest.raises(ConfigError) as caught:
        load_definitions(local)
    assert told in str(caught.value)


@pytest.mark.evbotos
@pytest.mark.timeout(3600)
def test_the_image_starts_with_its_own_kernel_which_has_wifi(tmp_path: Path) -> None:
    platform, image = load_definitions().chosen("qemu-amd64", "wireless")
    proof = built_proof(platform, image, tmp_path)
    assert proof.built.report["root_with_kernel_mb"] <= image.budget_mb.root_with_kernel
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", tmp_path / "disk.img"))
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        for command in image.check:
            answer(proof, machine, command)
        assert "country " in answer(proof, machine, "iw reg get")
        for driver in ("ath9k_htc", "mt7601u", "mt76x0u", "mt76x2u", "rt2800usb", "rtl8xxxu"):
            answer(proof, machine, f"test -d /sys/bus/usb/drivers/{driver}")
