SUMMARY = "The actor model for Python"
DESCRIPTION = "The actor model for Python; eal-actors is built on it."
HOMEPAGE = "https://pykka.readthedocs.io"
SECTION = "devel/python"
LICENSE = "Apache-2.0"
LIC_FILES_CHKSUM = "file://LICENSE;md5=3b83ef96387f14655fc854ddc3c6bd57"

PYPI_PACKAGE = "pykka"
SRC_URI[sha256sum] = "820fcc36046552b49d7eb61fe98088d1a29631cf3314e8ce4bc26aaead8dcd4f"

inherit pypi python_hatchling

RDEPENDS:${PN} += "\
    python3-core \
    python3-logging \
    python3-threading \
"
