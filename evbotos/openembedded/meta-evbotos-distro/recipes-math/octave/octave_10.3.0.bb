SUMMARY = "A language for numerical computations, compatible with Matlab for the most part"
DESCRIPTION = "GNU Octave for the command line: no windows, no Java, no documentation (thesis 5.2)."
HOMEPAGE = "https://octave.org"
SECTION = "math"
LICENSE = "GPL-3.0-or-later"
LIC_FILES_CHKSUM = "file://COPYING;md5=1ebbd3e34237af26da5dc08a4e440464"

# Thesis 3.4.3: the one obstacle of its build was a tool-chain without a Fortran compiler.
DEPENDS = "\
    bzip2 \
    fftw \
    gperf-native \
    lapack \
    libgfortran \
    libpcre2 \
    readline \
    zlib \
"

SRC_URI = "${GNU_MIRROR}/octave/octave-${PV}.tar.xz"
SRC_URI[sha256sum] = "92ae9bf2edcd288bd2df9fd0b4f7aa719b49d3940fceb154c5fdcd846f254da1"

inherit autotools pkgconfig texinfo

EXTRA_OECONF = "\
    --disable-docs \
    --disable-java \
    --disable-rpath \
    --with-blas=-lblas \
    --with-lapack=-llapack \
    --with-pcre2 \
    --without-amd \
    --without-arpack \
    --without-camd \
    --without-ccolamd \
    --without-cholmod \
    --without-colamd \
    --without-curl \
    --without-cxsparse \
    --without-fltk \
    --without-fontconfig \
    --without-freetype \
    --without-glpk \
    --without-hdf5 \
    --without-klu \
    --without-magick \
    --without-opengl \
    --without-portaudio \
    --without-qhull_r \
    --without-qrupdate \
    --without-qt \
    --without-sndfile \
    --without-spqr \
    --without-sundials_ida \
    --without-umfpack \
    --without-x \
"

FILES:${PN}-dev += "${libdir}/octave/${PV}/*${SOLIBSDEV}"
