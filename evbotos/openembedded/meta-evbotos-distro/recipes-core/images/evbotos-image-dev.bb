# Made by `python -m evbotos.agreement --write` out of the definitions; edit those.

SUMMARY = "EvBotOS: dev"
DESCRIPTION = "The robot image with what builds plugins - a compiler, git, gdb."

require evbotos-image.inc

IMAGE_INSTALL = "packagegroup-evbotos-dev"

# MiB, of the disk's parts.
EVBOTOS_BOOT_MIB = "16"
EVBOTOS_SLOT_MIB = "192"
EVBOTOS_DATA_MIB = "64"
