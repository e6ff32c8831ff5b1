SUMMARY = "Rigid bodies in two dimensions"
DESCRIPTION = "Rigid bodies in two dimensions; eal-actors is built on it."
HOMEPAGE = "https://www.pymunk.org"
SECTION = "devel/python"
LICENSE = "MIT"
LIC_FILES_CHKSUM = "file://LICENSE.txt;md5=9a083cdfe0d4f50227f92a2d3e106b20"

DEPENDS += "python3-cffi-native"

PYPI_PACKAGE = "pymunk"
SRC_URI[sha256sum] = "d36f10ac78355b5f4798d5b17e32100a1a1230258b1f37008f778ece72ddb719"

inherit pypi python_setuptools_build_meta

RDEPENDS:${PN} += "\
    python3-cffi \
    python3-core \
"
