# Made by `python -m evbotos.agreement --write` out of the definitions; edit those.

SUMMARY = "What each image installs"
DESCRIPTION = "One package group for each image of the definitions."
SECTION = "base"

PACKAGE_ARCH = "${MACHINE_ARCH}"

inherit packagegroup

PACKAGES = "\
    ${PN}-dev \
    ${PN}-minimal \
    ${PN}-octave \
    ${PN}-robot \
"

RDEPENDS:${PN}-dev = "\
    binutils \
    busybox \
    busybox-mdev \
    busybox-syslog \
    dropbear \
    evbotos-rootfs \
    evbotos-rootfs-hotplug \
    evbotos-rootfs-log \
    evbotos-rootfs-network \
    evbotos-rootfs-robot \
    evbotos-rootfs-ssh \
    evbotos-rootfs-time \
    evbotos-rootfs-update \
    evbotos-rootfs-watchdog \
    gcc \
    gcc-symlinks \
    gdb \
    git \
    glibc \
    libc6-dev \
    linux-libc-headers-dev \
    make \
    mdnsd \
    openntpd \
    python3-cffi \
    python3-core \
    python3-dev \
    python3-eclipse-zenoh \
    python3-modules \
    python3-msgpack \
    python3-numpy \
    python3-pydantic \
    python3-pykka \
    python3-pymunk \
    python3-pyserial \
    python3-pyyaml \
    python3-rich \
    python3-simpleeval \
    python3-structlog \
    python3-typer \
"

RDEPENDS:${PN}-minimal = "\
    busybox \
    busybox-mdev \
    busybox-syslog \
    dropbear \
    evbotos-rootfs \
    evbotos-rootfs-hotplug \
    evbotos-rootfs-log \
    evbotos-rootfs-network \
    evbotos-rootfs-ssh \
    evbotos-rootfs-time \
    evbotos-rootfs-watchdog \
    glibc \
    mdnsd \
    openntpd \
    python3-core \
    python3-modules \
"

RDEPENDS:${PN}-octave = "\
    busybox \
    busybox-mdev \
    busybox-syslog \
    dropbear \
    evbotos-rootfs \
    evbotos-rootfs-hotplug \
    evbotos-rootfs-log \
    evbotos-rootfs-network \
    evbotos-rootfs-ssh \
    evbotos-rootfs-time \
    evbotos-rootfs-watchdog \
    glibc \
    mdnsd \
    octave \
    openntpd \
    python3-core \
    python3-modules \
"

RDEPENDS:${PN}-robot = "\
    busybox \
    busybox-mdev \
    busybox-syslog \
    dropbear \
    evbotos-rootfs \
    evbotos-rootfs-hotplug \
    evbotos-rootfs-log \
    evbotos-rootfs-network \
    evbotos-rootfs-robot \
    evbotos-rootfs-ssh \
    evbotos-rootfs-time \
    evbotos-rootfs-update \
    evbotos-rootfs-watchdog \
    glibc \
    mdnsd \
    openntpd \
    python3-cffi \
    python3-core \
    python3-eal-actors \
    python3-eal-actors-plugins \
    python3-eclipse-zenoh \
    python3-modules \
    python3-msgpack \
    python3-numpy \
    python3-pydantic \
    python3-pykka \
    python3-pymunk \
    python3-pyserial \
    python3-pyyaml \
    python3-rich \
    python3-simpleeval \
    python3-structlog \
    python3-typer \
"
