# Made by `python -m evbotos.agreement --write` out of the definitions; edit those.

SUMMARY = "EvBotOS: minimal"
DESCRIPTION = "Python, SSH, DHCP, time and a name in the local network."

require evbotos-image.inc

IMAGE_INSTALL = "packagegroup-evbotos-minimal"

# MiB, of the disk's parts.
EVBOTOS_BOOT_MIB = "16"
EVBOTOS_SLOT_MIB = "48"
EVBOTOS_DATA_MIB = "15"
