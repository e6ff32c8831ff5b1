SUMMARY = "A small responder for names in the local network"
DESCRIPTION = "Answers to NAME.local, and tells of the robot's services."
HOMEPAGE = "https://github.com/troglobit/mdnsd"
SECTION = "net"
LICENSE = "BSD-3-Clause"
LIC_FILES_CHKSUM = "file://LICENSE;md5=564605c2e20a8e0cecde8071b3e67c16"

SRC_URI = "https://github.com/troglobit/mdnsd/archive/refs/tags/v${PV}.tar.gz;downloadfilename=mdnsd-${PV}.tar.gz"
SRC_URI[sha256sum] = "3ff069f16bef5c19b97386a3da5f1524d8cddf41157c75f220eeb9a81869dc82"

inherit autotools pkgconfig

EXTRA_OECONF = "--without-systemd"
