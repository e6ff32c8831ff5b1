# Made by `python -m evbotos.agreement --write` out of the definitions; edit those.

SUMMARY = "EvBotOS: robot"
DESCRIPTION = "eal serve with TLS, serial ports and the simulated base, started at boot and supervised."

require evbotos-image.inc

IMAGE_INSTALL = "packagegroup-evbotos-robot"

# MiB, of the disk's parts.
EVBOTOS_BOOT_MIB = "16"
EVBOTOS_SLOT_MIB = "48"
EVBOTOS_DATA_MIB = "15"
