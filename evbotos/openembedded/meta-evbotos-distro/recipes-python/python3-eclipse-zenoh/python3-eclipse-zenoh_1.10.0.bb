SUMMARY = "The network of eal-actors: publish, subscribe and query"
DESCRIPTION = "Python's binding of Zenoh, in Rust; its crates are fetched by their hashes, nothing while compiling."
HOMEPAGE = "https://zenoh.io"
SECTION = "devel/python"
LICENSE = "Apache-2.0 | EPL-2.0"
LIC_FILES_CHKSUM = "file://LICENSE;md5=530d837aca648e45704db71dedff39c4"

PYPI_PACKAGE = "eclipse_zenoh"
SRC_URI += "git://github.com/eclipse-zenoh/zenoh.git;protocol=https;branch=release/1.10.0;name=zenoh;destsuffix=zenoh"
SRC_URI[sha256sum] = "6904906783b7eb7ce8d5dbbb930b2e62c0ef93490b0e3dbf79e36fe4fd9727d6"
SRCREV_zenoh = "c479f0c1102d7321c2fa83f515bddede92014cce"
SRCREV_FORMAT = "zenoh"

require ${BPN}-crates.inc

inherit pypi python_maturin cargo-update-recipe-crates

# The crates of Zenoh itself come from the repository above and not from the network.
do_configure:append() {
    echo '[patch."https://github.com/eclipse-zenoh/zenoh.git"]' >> ${CARGO_HOME}/config.toml
    find ${UNPACKDIR}/zenoh -name Cargo.toml | sort | while read -r manifest; do
        crate=$(sed -n -e 's/^name = "\(.*\)"/\1/p' "$manifest" | head -n 1)
        [ -z "$crate" ] || echo "$crate = { path = \"$(dirname "$manifest")\" }" >> ${CARGO_HOME}/config.toml
    done
}

RDEPENDS:${PN} += "\
    python3-core \
    python3-json \
    python3-threading \
"
