# The machines of this layer that have a kernel of their own, and what robots need in it beside the board's drivers.
FILESEXTRAPATHS:prepend:evbotos-board := "${THISDIR}/files:"

COMPATIBLE_MACHINE:evbotos-beagle-armhf = "evbotos-beagle-armhf"
COMPATIBLE_MACHINE:evbotos-pc104-i686 = "evbotos-pc104-i686"
KBRANCH:evbotos-beagle-armhf ?= "v6.18/standard/base"
KBRANCH:evbotos-pc104-i686 ?= "v6.18/standard/base"
KMACHINE:evbotos-beagle-armhf ?= "beagleboard"
KMACHINE:evbotos-pc104-i686 ?= "intel-quark"
KBUILD_DEFCONFIG:evbotos-beagle-armhf = "omap2plus_defconfig"
KBUILD_DEFCONFIG:evbotos-pc104-i686 = "i386_defconfig"
KCONFIG_MODE:evbotos-beagle-armhf = "alldefconfig"
KCONFIG_MODE:evbotos-pc104-i686 = "alldefconfig"

SRC_URI:append:evbotos-board = " file://evbotos.cfg"
