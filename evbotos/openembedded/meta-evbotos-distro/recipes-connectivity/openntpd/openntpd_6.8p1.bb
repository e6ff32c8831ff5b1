SUMMARY = "A small client of the network time protocol"
DESCRIPTION = "Keeps the robot's clock right, by servers that DHCP or its configuration names."
HOMEPAGE = "https://www.openntpd.org"
SECTION = "net"
LICENSE = "BSD-3-Clause & ISC"
LIC_FILES_CHKSUM = "file://COPYING;md5=fe922aad2b6ad1c359cf2adfdaaab1b6"

SRC_URI = "https://cdn.openbsd.org/pub/OpenBSD/OpenNTPD/openntpd-${PV}.tar.gz"
SRC_URI[sha256sum] = "8582db838a399153d4a17f2a76518b638cc3020f58028575bf54127518f55a46"

inherit autotools useradd

EXTRA_OECONF = "--with-privsep-user=_ntpd --with-privsep-path=/run/openntpd"

do_install:append() {
    install -d ${D}${sysconfdir}/openntpd
    mv ${D}${sysconfdir}/ntpd.conf ${D}${sysconfdir}/openntpd/ntpd.conf
    rm -rf ${D}/run ${D}${localstatedir}/run
}

USERADD_PACKAGES = "${PN}"
USERADD_PARAM:${PN} = "--system --home-dir /run/openntpd --no-create-home --shell /bin/false --user-group _ntpd"
