"""Wi-Fi in a booted image, through the kernel's simulated radios: hostapd at the other end, in a network of its own."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors.kernel.log import get_logger
from evbotos.definitions import load_definitions
from evbotos.qemu import Machine
from evbotos.wireless import Wifi, WirelessNetwork
from tests.evbotos.proof import (
    DEBIAN_KERNEL,
    SERVES,
    Proof,
    answer,
    built_proof,
    compressed_quickly,
    ssh,
    started,
    wait_for_words,
    wait_until,
)

CIPHERS = ("ccm", "ctr", "cmac", "gcm")
KERNEL = DEBIAN_KERNEL.model_copy(
    update={"package": "linux-image-amd64", "modules": (*DEBIAN_KERNEL.modules, *CIPHERS, "bridge", "mac80211_hwsim")}
)
PASSPHRASE = 'correct "horse" battery'  # noqa: S105
WIFI = Wifi(
    country="DE",
    networks=(
        WirelessNetwork(name="Elsewhere"),
        WirelessNetwork(name="Lab", passphrase=PASSPHRASE),
    ),
)
BSS = """
ctrl_interface=/run/hostapd
ssid=Lab
wpa=2
wpa_key_mgmt=WPA-PSK SAE
rsn_pairwise=CCMP
ieee80211w=1
wpa_passphrase={passphrase}
bridge=br0
"""
ACCESS_POINT = """interface=wlan1
driver=nl80211
country_code=DE
hw_mode=g
channel=6
{bss}
bss=wlan1_1
{bss}
""".format(bss=BSS.format(passphrase=PASSPHRASE))
ADDRESSES = """start 192.168.77.20
end 192.168.77.30
interface br0
lease_file /run/udhcpd.leases
option subnet 255.255.255.0
"""
IN_AP = "nsenter -t $(cat /run/ap) -n"
OWN_NETWORK = f"""
(unshare -n sleep 1000000 >/dev/null 2>&1 & echo $! >/run/ap)
sleep 1
iw phy phy1 set netns "$(cat /run/ap)"
{IN_AP} brctl addbr br0
{IN_AP} ip addr add 192.168.77.1/24 dev br0
{IN_AP} ip link set br0 up
: >/run/udhcpd.leases
"""
START_AP = f"{IN_AP} hostapd -B -P /run/hostapd.pid /run/ap.conf"
_LOG = get_logger()

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Proof, Machine]]:
    """A running robot with a simulated radio, started by Debian's own kernel, which has that radio."""
    folder = tmp_path_factory.mktemp("wifi")
    board, wireless = load_definitions().chosen("qemu-amd64", "wireless")
    platform = board.model_copy(update={"kernel": KERNEL})
    image = wireless.model_copy(update={"packages": (*wireless.packages, "hostapd")})
    with compressed_quickly():
        proof = built_proof(platform, image, folder, current_packages=True, settings={"wifi": WIFI})
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", folder / "disk.img"))
    with started(proof, disk, memory_mb=256) as machine:
        wait_for_words(machine, SERVES)
        answer(proof, machine, OWN_NETWORK)
        answer(proof, machine, "cat >/run/ap.conf", ACCESS_POINT.encode())
        answer(proof, machine, "cat >/run/udhcpd.conf", ADDRESSES.encode())
        yield proof, machine


def is_reached(proof: Proof, machine: Machine) -> bool:
    """Return whether the access point answers through the air."""
    return ssh(proof, machine, "ping -c 1 -W 2 -I wlan0 192.168.77.1").returncode == 0


def radio(proof: Proof, machine: Machine, field: str) -> str:
    """Return a field of what wpa_supplicant reports."""
    told = answer(proof, machine, "wpa_cli -p /run/wpa_supplicant -i wlan0 status")
    return dict(line.split("=", 1) for line in told.splitlines() if "=" in line).get(field, "")


def test_a_robot_joins_its_network_and_returns_to_it_and_roams(machine: tuple[Proof, Machine]) -> None:
    proof, booted = machine
    answer(proof, booted, START_AP)
    answer(proof, booted, f"{IN_AP} udhcpd -S /run/udhcpd.conf")
    wait_for_words(booted, "evbotos: wlan0 is in the network Lab")
    wait_until(booted, "the access point answers", lambda: is_reached(proof, booted))
    assert "192.168.77." in answer(proof, booted, "ip -4 addr show dev wlan0")
    assert "country DE" in answer(proof, booted, "iw reg get")
    assert radio(proof, booted, "key_mgmt") in ("SAE", "WPA2-PSK")
    assert answer(proof, booted, "ls -l /data/wifi/given.conf /data/wifi/wifi.conf").count("-rw-------") == 2

    answer(proof, booted, "kill $(cat /run/hostapd.pid)")
    wait_for_words(booted, "evbotos: wlan0 has left its network")
    answer(proof, booted, f"while [ -e /run/hostapd.pid ]; do sleep 0.1; done; {START_AP}")
    wait_for_words(booted, "evbotos: wlan0 is in the network Lab", times=2)
    wait_until(booted, "the access point answers again", lambda: is_reached(proof, booted))

    first, own = radio(proof, booted, "bssid"), radio(proof, booted, "address")
    links = answer(proof, booted, f"{IN_AP} ip -o link show")
    (named,) = [line.split()[1].rstrip(":") for line in links.splitlines() if first in line and " wlan1" in line]
    answer(proof, booted, f"hostapd_cli -p /run/hostapd -i {named} deny_acl ADD_MAC {own}")
    wait_until(booted, "another access point", lambda: radio(proof, booted, "bssid") not in ("", first))
    wait_until(booted, "the other access point answers", lambda: is_reached(proof, booted))


def test_networks_change_at_run_time_and_stay(machine: tuple[Proof, Machine]) -> None:
    proof, booted = machine
    cli = "wpa_cli -p /run/wpa_supplicant -i wlan0"
    number = answer(proof, booted, f"{cli} add_network").strip()
    answer(proof, booted, f"{cli} set_network {number} ssid 4f74686572 && {cli} set_network {number} key_mgmt NONE")
    answer(proof, booted, f"{cli} enable_network {number} && {cli} save_config")
    assert 'ssid="Other"' in answer(proof, booted, "cat /data/wifi/wifi.conf")
    before = answer(proof, booted, "pidof wpa_supplicant")
    answer(proof, booted, "killall wpa_supplicant")
    wait_until(booted, "a new start", lambda: ssh(proof, booted, "pidof wpa_supplicant").stdout not in ("", before))
    wait_until(booted, "the same networks", lambda: "Other" in ssh(proof, booted, f"{cli} list_networks").stdout)
