# nooelint: oelint.var.mandatoryvar.HOMEPAGE
SUMMARY = "What starts a robot: the kernel's first program, and its services"
DESCRIPTION = "The very files of ../../../../rootfs that the images built of Debian's packages get. Each service is a package."
SECTION = "base"
LICENSE = "Apache-2.0"
# nooelint: oelint.var.licenseremotefile - the files are a part of this repository, whose licence it is
LIC_FILES_CHKSUM = "file://${COMMON_LICENSE_DIR}/Apache-2.0;md5=89aea4e17d99a7cacdbeed46a0096b10"

# nooelint: oelint.vars.fileextrapaths,oelint.vars.outofcontext - both tracks install the same files, from one place
FILESEXTRAPATHS:prepend := "${THISDIR}/../../../../:"
SRC_URI = "file://rootfs"
S = "${UNPACKDIR}/rootfs"

require evbotos-services.inc

inherit useradd
USERADD_PACKAGES = "${PN}-network ${PN}-robot"
GROUPADD_PARAM:${PN}-robot = "--system gpio; --system i2c; --system pwm; --system spi"
USERADD_PARAM:${PN}-network = "--system --no-create-home --home-dir / --shell /bin/false --user-group mdns"
USERADD_PARAM:${PN}-robot = "\
    --system --no-create-home --home-dir / --shell /bin/false --user-group --groups dialout,video,gpio,i2c,pwm,spi robot \
"

PACKAGE_ARCH = "${MACHINE_ARCH}"

do_configure[noexec] = "1"
do_compile[noexec] = "1"

do_install() {
    cp -R --no-dereference --preserve=mode,links "${S}/base/." ${D}/
    for file in ${EVBOTOS_PROVIDED}; do
        rm -f ${D}/$file
    done
    for service in ${EVBOTOS_SERVICES}; do
        cp -R --no-dereference --preserve=mode,links "${S}/services/$service/." ${D}/
        rm -f ${D}/inittab
        install -d ${D}${sysconfdir}/evbotos/inittab.d
        install -m 0644 "${S}/services/$service/inittab" ${D}${sysconfdir}/evbotos/inittab.d/$service
    done
    for program in ${EVBOTOS_IN_SBIN}; do
        install -d ${D}${bindir}
        ln -s ../sbin/$program ${D}${bindir}/$program
    done
    for folder in data media ro; do
        install -d ${D}/$folder
    done
    install -d ${D}${sysconfdir}/evbotos
    echo "${MACHINE}" | sed -e 's/^evbotos-//' > ${D}${sysconfdir}/evbotos/platform
    chown -R root:root ${D}
}

FILES:${PN} += "${prefix} /data /media /ro"
RCONFLICTS:${PN} = "busybox-inittab sysvinit-inittab"
