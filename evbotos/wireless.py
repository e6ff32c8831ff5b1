"""Settings of Wi-Fi: `wifi` in local.yaml, and the configuration of wpa_supplicant that they become."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from eal_actors.kernel.strict_model import StrictModel

FILE: Final = "wifi.conf"
"""The configuration among the robot's files."""
_HEAD: Final = ("ctrl_interface=/run/wpa_supplicant", "update_config=1")
_ROAM: Final = 'bgscan="simple:30:-65:300"'
"""Look for a stronger access point every 30 s below -65 dBm, else every 300 s."""


class WirelessNetwork(StrictModel):
    """A network to join."""

    name: Annotated[str, Field(min_length=1, max_length=32)]
    """Its SSID."""
    passphrase: Annotated[str, Field(pattern=r"^[ -~]{8,63}$")] | None = None
    """Of WPA2 or WPA3; None for an open network."""
    hidden: bool = False
    """Whether the network does not announce its name."""


class Wifi(StrictModel):
    """The robot's wireless networks, and where it is."""

    country: Annotated[str, Field(pattern=r"^[A-Z]{2}$")]
    """Selects the permitted channels and powers, such as DE."""
    networks: Annotated[tuple[WirelessNetwork, ...], Field(strict=False, min_length=1)]
    """The best first."""


def configuration(wifi: Wifi) -> str:
    """Return the configuration file of wpa_supplicant."""
    lines = [*_HEAD, f"country={wifi.country}"]
    for number, network in enumerate(reversed(wifi.networks)):
        if network.passphrase is None:
            secret = ["key_mgmt=NONE"]
        else:
            secret = ["key_mgmt=WPA-PSK SAE", "ieee80211w=1", f'psk="{network.passphrase}"']
        name = network.name.encode().hex()  # as a text it would need escapes
        fields = [f"ssid={name}", f"scan_ssid={int(network.hidden)}", f"priority={number}", *secret, _ROAM]
        lines += ["network={", *(f"    {field}" for field in fields), "}"]
    return "\n".join([*lines, ""])
