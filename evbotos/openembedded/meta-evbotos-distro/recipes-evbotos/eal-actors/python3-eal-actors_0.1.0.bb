# nooelint: oelint.var.mandatoryvar.SRC_URI,oelint.var.mandatoryvar.HOMEPAGE - built from the checkout around this layer
SUMMARY = "One scenario across a fleet of different robots"
DESCRIPTION = "The framework, the program eal, and its plugins, each in a package with what it needs."
SECTION = "devel/python"
LICENSE = "Apache-2.0"
LIC_FILES_CHKSUM = "file://LICENSE;md5=3b83ef96387f14655fc854ddc3c6bd57"

# Built from the checkout that this layer is a part of.
inherit externalsrc
EXTERNALSRC = "${@os.path.abspath('${THISDIR}/../../../../..')}"

require eal-actors-plugins.inc

inherit python_hatchling

RDEPENDS:${PN} += "\
    python3-core \
    python3-eclipse-zenoh \
    python3-modules \
    python3-msgpack \
    python3-pydantic \
    python3-pykka \
    python3-pyserial \
    python3-pyyaml \
    python3-rich \
    python3-simpleeval \
    python3-structlog \
    python3-typer \
"
