SUMMARY = "Evaluates expressions without Python's own eval"
DESCRIPTION = "Evaluates expressions without Python's own eval; eal-actors is built on it."
HOMEPAGE = "https://github.com/danthedeckie/simpleeval"
SECTION = "devel/python"
LICENSE = "MIT"
LIC_FILES_CHKSUM = "file://LICENCE;md5=aed013161b2a0bfa75e69eeb4e8a89e7"

PYPI_PACKAGE = "simpleeval"
SRC_URI[sha256sum] = "b417f869c11f2de034eb919820a825f35d12ce99f63a43971947ce73679eb9ba"

inherit pypi python_hatchling

RDEPENDS:${PN} += "python3-core"
