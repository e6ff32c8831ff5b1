# Made by `python -m evbotos.agreement --write` out of the definitions; edit those.

SUMMARY = "EvBotOS: octave"
DESCRIPTION = "Octave with all that it reads and computes, Python and SSH, within the thesis's 65 MB."

require evbotos-image.inc

IMAGE_INSTALL = "packagegroup-evbotos-octave"

# MiB, of the disk's parts.
EVBOTOS_BOOT_MIB = "16"
EVBOTOS_SLOT_MIB = "96"
EVBOTOS_DATA_MIB = "15"
