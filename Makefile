# Two commands on a fresh machine: `make demo` and `make test`. Everything lives in .venv.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
LOCK := .ci/lock.txt
# A worker takes a whole file, the next one in the order that tests/conftest.py gives them.
PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

# Debian and Ubuntu keep venv in a package of its own.
SUDO := $(shell test "$$(id -u)" = 0 || echo sudo)
INSTALL_VENV := { echo "Installing python3-venv, which $(PYTHON) -m venv needs"; $(SUDO) apt-get update -qq && $(SUDO) DEBIAN_FRONTEND=noninteractive apt-get install -y -qq python3-venv >/dev/null; }

# What `evbotos build` and `evbotos run` call; evbotos/hosttools.py names each where one is missing.
EVBOTOS_TOOLS := apt bc binutils bison cryptsetup-bin device-tree-compiler dosfstools dpkg e2fsprogs exfatprogs fdisk flex gcc gcc-aarch64-linux-gnu gcc-arm-linux-gnueabihf \
	grub-common libelf-dev libssl-dev make mtools openssh-client ovmf qemu-system-arm qemu-system-x86 squashfs-tools \
	tar u-boot-tools xz-utils zstd

.PHONY: lock locked sbom demo demo-aarch64 test-aarch64 container demo-network demo-standards lab test test-slow check docs bench bench-peers bench-scale bench-go bench-panorama bench-jitter bench-proof bench-lookahead soak fuzz fuzz-motions figures format evbotos-setup test-evbotos test-fleet-update test-fleet-of-machines test-bitbake clean help

help:  ## show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or later is needed; name it with: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || $(INSTALL_VENV)
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade 'pip>=25.1'
	$(BIN)/python -m pip install --quiet --editable '.[sim,vision,record,system,dashboard,evbotos,metrics,top]' --group dev
	@touch $(STAMP)

lock:  ## resolve the development environment again, and write its versions and hashes
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --quiet --all-extras --group dev --universal --python-version 3.11 --generate-hashes --upgrade \
		--no-emit-index-url --no-header --no-annotate --output-file $(LOCK).new pyproject.toml
	@{ echo '# Every package of the development environment, with hashes. Written by `make lock`; installed by `make locked`.'; \
		cat $(LOCK).new; } > $(LOCK); rm $(LOCK).new

locked:  ## make the environment from the lock alone, each file checked against its hash
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --require-hashes --requirement $(LOCK)
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	@touch $(STAMP)

sbom: $(STAMP)  ## build the packages, and the wheel's bill of materials in CycloneDX
	rm -rf build/dist
	$(BIN)/python -m hatchling build -d build/dist
	$(BIN)/python -m tests.house.sbom build/dist/*.whl build/sbom.cdx.json

demo: $(STAMP)  ## run the dance and two formations on a simulated fleet, and show the picture and the film
	$(BIN)/eal run scenarios/ballet.yaml --fleet fleets/formation.yaml --rate max --film --show

demo-network: $(STAMP)  ## the same dance over the network: three robots, each served by a process of its own
	$(BIN)/eal demo-network

demo-standards: $(STAMP)  ## a ROS 2 robot, an AGV, a MAVLink rover and a Roomba drive a square together; one fails
	$(BIN)/python -m tests.standards

# Debian's Python for 64-bit ARM, unpacked and not installed, with this project's packages for it. The code is that of this folder.
AARCH64 := build/aarch64
ON_AARCH64 := qemu-aarch64-static -L $(AARCH64) -E PYTHONPATH=$(AARCH64)/site $(AARCH64)/usr/bin/python3.11
AARCH64_TESTS := tests/unit/kernel/test_lock_step.py tests/actors/test_inbox.py tests/actors/test_future.py \
	tests/unit/plugins/evbot2/test_protocol.py tests/unit/plugins/roomba/test_oi_packets.py

$(AARCH64)/.made: $(STAMP)
	@command -v mmdebstrap qemu-aarch64-static >/dev/null || { echo "make $(MAKECMDGOALS) needs Debian's packages mmdebstrap and qemu-user-static"; exit 1; }
	rm -rf $(AARCH64) && mkdir -p build
	mmdebstrap --quiet --variant=extract --architectures=arm64 --include=python3,libstdc++6,libgomp1,zlib1g,tzdata bookworm $(AARCH64)
	$(BIN)/python -m pip install --quiet --target $(AARCH64)/site --platform manylinux_2_28_aarch64 --platform manylinux2014_aarch64 \
		--platform manylinux_2_17_aarch64 --python-version 3.11 --implementation cp --only-binary=:all: ".[sim,record,system]" \
		hypothesis pytest pytest-rerunfailures pytest-timeout
	@touch $@

demo-aarch64: $(AARCH64)/.made  ## the dance on 64-bit ARM, under qemu-user
	$(ON_AARCH64) -m eal_actors run dance --fleet sim --rate max --no-plot

test-aarch64: $(AARCH64)/.made  ## tests of the clock, the mailboxes, the futures and two drivers' protocols on 64-bit ARM, under qemu-user
	$(ON_AARCH64) -m pytest -p no:cacheprovider -q $(AARCH64_TESTS)

container:  ## build the image of Containerfile on Debian's Python, with buildah; CONTAINER_FLAGS are options of `buildah build`
	@command -v mmdebstrap buildah >/dev/null || { echo "make container needs Debian's packages mmdebstrap and buildah"; exit 1; }
	rm -rf build/container && mkdir -p build/container
	mmdebstrap --quiet --variant=minbase --include=python3-venv --dpkgopt='path-exclude=/usr/share/doc/*' \
		--dpkgopt='path-exclude=/usr/share/man/*' --dpkgopt='path-exclude=/usr/share/locale/*' bookworm build/container/base.tar
	printf 'FROM scratch\nADD base.tar /\n' > build/container/Containerfile
	buildah build --quiet -t eal-base build/container
	buildah build --build-arg BASE=localhost/eal-base $(CONTAINER_FLAGS) -t eal-actors .

lab: $(STAMP)  ## the thesis's robots, each behind its own wire to an emulator, drive the square, dance, patrol and take panoramas
	$(BIN)/eal lab
	$(BIN)/eal lab patrol panorama --fleet lab-world

test: $(STAMP)  ## run the tests; what it deselects, test-slow and test-evbotos run
	$(PYTEST)

test-slow: $(STAMP)  ## run the tests that take many seeds
	$(PYTEST) -m 'slow and not evbotos'

check: $(STAMP)  ## format, lint, types, layers, prose, security, JavaScript, and the docs with all their commands
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/bandit --quiet --configfile pyproject.toml --recursive eal_actors evbotos plugins scenarios
	$(BIN)/python -m tests.house.prose
	$(BIN)/python -m tests.house.javascript
	$(BIN)/python -m tests.house.audit
	$(BIN)/python -m pytest -q -m 'docs and not evbotos'

docs: $(STAMP)  ## build the site into build/site; a broken link or reference is an error
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet -c docs . build/site
	@echo build/site/index.html

bench: $(STAMP)  ## measure against bare Pykka and bare pymunk, as ratios in one run
	$(BIN)/python -m tests.benchmarks

bench-peers: $(STAMP)  ## measure against others that call robots, as ratios to raw TCP; writes docs/peers.md
	@$(BIN)/python -m pip install --quiet --group peers || echo "Not all of the group 'peers' could be installed; those are left out"
	$(BIN)/python -m tests.benchmarks.peers

bench-scale: $(STAMP)  ## measure what a robot costs among 10, 100 and 1,000; writes its figures into docs/scaling.md
	$(BIN)/python -m tests.benchmarks.scale

bench-go: $(STAMP)  ## measure robots that go where they are sent, 20 seeds each, judged by the true pose
	$(BIN)/python -m tests.benchmarks.go --page docs/navigation.md

bench-panorama: $(STAMP)  ## measure panoramas of frames with faults; writes docs/panorama.md
	$(BIN)/python -m tests.benchmarks.panorama --page docs/panorama.md

bench-jitter: $(STAMP)  ## measure a loop of 50 Hz in a built robot image by the kernel's preemption; writes docs/evbotos.md
	$(BIN)/python -m tests.benchmarks.jitter build/evbotos/qemu-amd64-robot --page docs/evbotos.md

bench-lookahead: $(STAMP)  ## measure the look-ahead with ten robots; writes docs/proving.md
	$(BIN)/python -m tests.benchmarks.lookahead --page docs/proving.md

bench-proof: $(STAMP) bench-lookahead  ## prove the shipped scenarios and ten planted bugs, foretell contacts, kill a hundred controllers; writes docs/proving.md
	$(BIN)/python -m tests.benchmarks.proof --others --planted --page docs/proving.md
	$(BIN)/python -m pytest -n 0 -q -m slow -rP tests/net/test_second_life.py

soak: $(STAMP)  ## twenty robots under kills, freezes, cuts, floods and garbage for twenty minutes; writes docs/soak.md
	$(BIN)/python -m tests.soak --page docs/soak.md

fuzz: $(STAMP)  ## fuzz each decoder and loader for a minute
	$(BIN)/python -m tests.fuzz

fuzz-motions: $(STAMP)  ## 10,000 motions of each driver over wires that damage bytes, judged by the true path; resumes after an interruption
	$(BIN)/python -m tests.fuzz.series

# By PYTHONPATH, our package `tests` comes before that of a dependency.
figures: $(STAMP)  ## make the pictures of the documentation
	PYTHONPATH=. $(BIN)/python docs/figures.py

format: $(STAMP)  ## format the code and mend what the linter can
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

evbotos-setup:  ## install the programs that build and test images of EvBotOS (Debian and Ubuntu)
	$(SUDO) apt-get update -qq
	$(SUDO) DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $(EVBOTOS_TOOLS)

test-evbotos: $(STAMP)  ## build images, boot them in QEMU and test them, with updates and power cuts; and input devices, in a guest
	@$(BIN)/python -m pip install --quiet 'evdev>=1.9' || echo "evdev could not be installed; input devices are left out"
	$(BIN)/python -m pytest tests/evbotos -m evbotos -rA --timeout=3600

test-fleet-update: $(STAMP)  ## update ten robots over TLS, with a power cut and a failure, each robot in processes of its own
	EVBOTOS_ROBOTS=10 $(PYTEST) -n 0 -m slow tests/evbotos/test_update_of_ten.py

test-fleet-of-machines: $(STAMP)  ## update ten booted machines in QEMU over TLS, with a power cut and a failure
	EVBOTOS_ROBOTS=10 $(PYTEST) -n 0 -m evbotos tests/evbotos/test_update_of_booted.py

test-bitbake: $(STAMP)  ## plan the OpenEmbedded images with real BitBake from a folder of git mirrors: MIRRORS=/srv/git
	@$(BIN)/python -m tests.evbotos.bitbake $(MIRRORS)

clean:  ## remove the environment and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
