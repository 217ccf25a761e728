# Everything that a user or CI does here. "make sim" and "make test" are all it takes on a fresh
# machine.

SHELL := /bin/bash
.DELETE_ON_ERROR:
# Or cargo would look for make's jobs.
unexport MAKEFLAGS MFLAGS

TARGET_DIR := $(or $(CARGO_TARGET_DIR),target)
BUILD_STD := -Zbuild-std=core -Zjson-target-spec
AVR := --profile firmware --target avr-specs/avr-atmega168.json $(BUILD_STD)
AVR_328P := --profile firmware --target avr-specs/avr-atmega328p.json $(BUILD_STD)
# The board and the CAN board, entries of avr-specs/boards.toml, and wires of one's own. Empty: the
# table's default.
BOARD ?=
SHIELD ?=
CS ?=
INT ?=
CRYSTAL ?=
WIRING := --board '$(BOARD)' --shield '$(SHIELD)' --cs '$(CS)' --int '$(INT)' --crystal '$(CRYSTAL)'
# What the firmware has: a preset (default, full, remote, thesis), or a list of features with
# commas. Empty: the preset of the board's chip.
FEATURES ?=
# Silent: make expands a recipe before it runs it, and the script that builds the firmware prints
# what is wrong.
ELF = $(shell scripts/firmware --path $(WIRING) '$(FEATURES)' 2>/dev/null)
GDB_ELF = $(shell scripts/firmware --path --gdb $(WIRING) '$(FEATURES)' 2>/dev/null)
# Presets with which the library is tested, and tunnel, relay and rpm, features that are in none of
# them; and builds that the tests on simulated boards use.
PRESETS := default full remote thesis tunnel relay rpm
SHIPPED := default remote thesis
# Boards with the other chip, and test files with all that can differ on them.
UNO := --board uno --shield seeed
UNO_MODULE := --board uno --shield module
ON_UNO := bounds budget bus_faults controller full_bus load restart servo update update_clients
# The tests' board.
ON_BOARD := NODE_BOARD='$(BOARD)' NODE_SHIELD='$(SHIELD)'
VENV := .venv
# Programs for this machine, and the directory in whose bin "make install" puts them.
PROGRAMS := $(abspath $(TARGET_DIR))/release
PREFIX ?= $(or $(CARGO_INSTALL_ROOT),$(CARGO_HOME),$(HOME)/.cargo)
TOOLS := $(TARGET_DIR)/tools

# The words of "make help", and those of tests and of environments. Make itself ignores a misspelt
# word: it would build for another board.
WORDS := BOARD SHIELD CS INT CRYSTAL FEATURES PORT ARGS PREFIX NODE BUS FILE PROGRAMMER STOCK WEB_PORT HOURS \
	SEED TIME MINUTES WHY ONLY FUZZ_SEED CROSS_SECONDS CROSS_SEED CROSS_BROWSER
OTHER_WORDS := PRESETS SHIPPED ON_UNO TEST_FILES LONG LONG_TESTS CLIENTS FUZZED WEB_TESTS CHROMIUM PROGRAMS \
	TOOLS VENV TARGET_DIR CARGO_% FUZZ_% NODE_% RUST% SOAK_%
$(foreach name,$(.VARIABLES),$(if $(findstring command line,$(origin $(name))),$(if \
	$(filter $(WORDS) $(OTHER_WORDS),$(name)),,$(error $(name)= is wrong. make has the words $(WORDS)))))

.PHONY: help wiring drawings sim gdb bridge sim-program bridge-program update-program install
.PHONY: lint-firmware deny advisories test test-all fuzz fuzz-coverage soak reliability mutants
.PHONY: elf-mutants boot bootloader dist build-twice update firmware firmware-gdb firmwares
.PHONY: third-party flash size budget bench lint setup clean
.PHONY: bounds bounds-page losses test-bounds test-packages test-library test-host test-bounds test-firmware
.PHONY: test-uno test-boards test-clients test-web web web-page web-pictures
.PHONY: cross-check
help:
	@echo "make sim        build the firmware and watch it work on a simulated board and CAN bus  (ARGS=\"--for 5s\"); five minutes the first time"
	@echo "make gdb        the same, waiting for avr-gdb on port 3333"
	@echo "make bridge     show what a ground station sees of the node through MAVLink: simulator and bridge"
	@echo "make web        build a web page in which the firmware runs on a simulated board and bus, and serve it  (WEB_PORT=8000)"
	@echo "make install    the firmware, and the commands sim, bridge and node-update in ~/.cargo/bin  (PREFIX=/usr/local for /usr/local/bin)"
	@echo "make test       the tests that CI runs, except those of the page; about 20 minutes the first time; installs what is missing first"
	@echo "make test-web   the web page in Chromium, and its processor against simavr: four minutes the first time"
	@echo "make test-all   these two, and then the long tests below"
	@echo "make fuzz       a million random and mutated frames and transfers  (FUZZ_SEED=1 for others)"
	@echo "make fuzz-coverage   the parsers in libFuzzer, a minute each  (TIME=900)"
	@echo "make soak       run a node with random faults for an hour  (HOURS=4, SEED=7 for other faults; Ctrl-C ends it with a summary)"
	@echo "make mutants    put mistakes into the sources that the unit tests must notice: hours; make elf-mutants: into the firmware, for the tests on boards"
	@echo "make reliability   measure the recovery from every fault, and write docs/reliability.md"
	@echo "make firmware   build the firmware, and print its size"
	@echo "make boot       build the bootloader, for firmware updates over the bus (docs/update.md)"
	@echo "make update     send the firmware to a node over the bus  (NODE=120 BUS=slcan:/dev/ttyACM0; NODE=all, FILE=other.bin)"
	@echo "make bootloader write the bootloader to an Arduino with a programmer  (PROGRAMMER=usbasp; STOCK=file.hex restores the board's own)"
	@echo "make dist       firmware and bootloader of every board, with licences and checksums, in target/dist  (ten minutes; BOARD=uno SHIELD=module for one, two minutes)"
	@echo "make build-twice   check that two builds of the last commit have the same bytes, in two directories  (two minutes)"
	@echo "make flash      upload it to an Arduino and open its serial monitor  (PORT=/dev/ttyUSB0)"
	@echo "make cross-check   run the firmware on avr8js and on simavr, and compare all that they do  (CROSS_SECONDS=60, CROSS_SEED=7; CROSS_BROWSER=1)"
	@echo "make bounds     prove stack and cycles of the firmware from its machine code (docs/bounds.md)"
	@echo "make size       size of the firmware by function"
	@echo "make budget     build every preset and feature, and write their sizes to docs/budget.md"
	@echo "make wiring     write docs/wiring.md from avr-specs/boards.toml"
	@echo "make drawings   write docs/img/frame.svg and memory.svg; make lint checks that they are up to date"
	@echo "make bench      measure the firmware in cycles of the AVR, and write docs/benchmarks.md (six minutes and then make losses)"
	@echo "make losses     count the frames that are lost on a full bus, ten simulated minutes of each kind: hours  (BOARD=uno; MINUTES=0.1; WHY=1; ONLY=position)"
	@echo "make lint       formatting and clippy, for both targets, warnings as errors"
	@echo "make deny       check licences and origins of all dependencies, and that only the simulator links simavr"
	@echo "make clean      remove what was built"
	@echo
	@echo "FEATURES=thesis chooses another preset for sim, gdb, firmware, flash, size and bench: default, full, remote or thesis;"
	@echo "FEATURES=save-answers  this feature besides the default; several with commas, if they fit."
	@echo "BOARD=uno SHIELD=module chooses another board for them and for test; after a wrong name make lists the right ones. CS=D8 INT=D3 CRYSTAL=8"
	@echo "are for other wiring. See docs/wiring.md."

# Compilers print on stderr, so that stdout has only the output of the program.
sim:
	@$(MAKE) --no-print-directory firmware sim-program >&2
	@NODE_ELF=$(ELF) $(PROGRAMS)/sim $(ARGS)

# Debugs an ELF of its own: see docs/bench.md.
gdb:
	@$(MAKE) --no-print-directory firmware-gdb sim-program >&2
	@NODE_ELF=$(GDB_ELF) $(PROGRAMS)/sim --plain --gdb 3333 $(ARGS)

bridge:
	@scripts/setup bridge >&2
	@$(MAKE) --no-print-directory firmware $(VENV)/installed sim-program bridge-program >&2
	@$(VENV)/bin/python scripts/bridge-demo $(ARGS)

# A call for each, so that cargo builds for one what it has built for the other.
sim-program:
	@scripts/setup build
	@test -e $(PROGRAMS)/sim || echo "Compiling the simulator: four minutes on two cores the first time"
	@cargo build --release -p sim

bridge-program:
	@scripts/setup build
	@test -e $(PROGRAMS)/bridge || echo "Compiling the bridge: a minute on two cores the first time"
	@cargo build --release -p bridge

update-program:
	@scripts/setup build
	@test -e $(PROGRAMS)/node-update || echo "Compiling the program: a minute on two cores the first time"
	@cargo build --quiet --release -p node-update

# The page with the programs of the release, and the bundles of the cross-check. Without a port the
# server takes any free one.
WEB_PORT ?= 0
web: web-page
	@node web/serve.mjs '$(TARGET_DIR)/web' $(WEB_PORT)

web-page:
	@scripts/setup web
	@test -e $(TARGET_DIR)/web/app.js || echo "Building the page: three minutes on two cores the first time"
	@scripts/firmware $(SHIPPED) >&2
	@scripts/firmware $(UNO) full >&2
	@scripts/web

# Both processors run the same programs with the same traffic, and then each instruction with random
# operands.
cross-check: web-page
	cargo test -p web --test cross_check -- --nocapture
	cargo test -p bench --test opcodes -- --ignored

# The installed sim finds the firmware where "make firmware" leaves it. Offline: all has been
# compiled, and cargo would look for newer crates.
install: firmware sim-program bridge-program update-program
	@set -e; for path in sim host/bridge host/update; do cargo install --quiet --locked --offline --root '$(PREFIX)' --path $$path; done
	@echo "Installed sim, bridge and node-update in $(PREFIX)/bin"
	@case ":$$PATH:" in *:'$(PREFIX)/bin':*) ;; *) echo "The shell does not look there yet: add it to PATH" ;; esac
	@$(if $(BOARD)$(SHIELD)$(FEATURES),echo "sim without --elf simulates the default firmware. For this one: sim --elf '$(abspath $(ELF))'")

firmware:
	@scripts/setup build
	@test -e $(ELF) || echo "Compiling the firmware: a minute on two cores the first time"
	@scripts/firmware $(WIRING) '$(FEATURES)'

firmware-gdb:
	@scripts/setup build
	@scripts/firmware --gdb $(WIRING) '$(FEATURES)'

boot:
	@scripts/setup build
	@scripts/boot $(WIRING)

# A wrong word ends it before anything is installed or built.
BOOTLOADER = scripts/bootloader $(WIRING) --programmer '$(PROGRAMMER)' --port '$(PORT)' $(if $(STOCK),--stock '$(STOCK)')
bootloader:
	@$(BOOTLOADER) --check
	@$(MAKE) --no-print-directory boot
	@scripts/setup flash
	@$(BOOTLOADER)

# Without FILE= the firmware of the board, with a preset that can be updated over the bus again.
update: FEATURES := $(or $(FEATURES),$(shell scripts/firmware --update-preset $(WIRING) 2>/dev/null))
update:
	@test '$(BUS)' || { echo 'Say which bus: make update NODE=120 BUS=slcan:/dev/ttyACM0' >&2; exit 2; }
	@test '$(NODE)' || { echo 'Say which node: make update NODE=120 BUS=$(BUS), or NODE=all' >&2; exit 2; }
	@test -z '$(FILE)' || test -r '$(FILE)' || { echo 'FILE=$(FILE) is no file that you can read' >&2; exit 2; }
	$(if $(FILE),,@$(MAKE) --no-print-directory firmware FEATURES='$(FEATURES)')
	@$(MAKE) --no-print-directory update-program
	@$(PROGRAMS)/node-update $(if $(FILE),'$(FILE)',$(ELF:.elf=.bin)) --bus '$(BUS)' --node '$(NODE)' \
		$(if $(findstring --bitrate,$(ARGS)),,--bitrate $(shell scripts/firmware --bit-rate $(WIRING))) $(ARGS)

# Everything for a release, in target/dist: about ten minutes.
dist: $(TOOLS)/bin/cargo-about
	@scripts/setup build
	@scripts/dist $(WIRING)

# That two builds of one commit have the same bytes: two minutes.
build-twice: $(TOOLS)/bin/cargo-about
	@scripts/setup build
	@scripts/build-twice $(WIRING)

firmwares:
	@scripts/setup build
	@scripts/boot
	@scripts/boot $(UNO)
	@scripts/firmware $(SHIPPED)
	@scripts/firmware --gdb
	@scripts/firmware $(UNO) full default tunnel relay rpm outputs,rpm
	@scripts/boot $(UNO_MODULE)
	@scripts/firmware $(UNO_MODULE) full
	$(if $(BOARD)$(SHIELD),@scripts/firmware $(WIRING) '' $(SHIPPED) && scripts/boot $(WIRING))

# Firmwares with third-party drivers, which test the model of the MCP2515. Cargo unites features
# over the packages of one call, so the one that needs another feature of its crate is a call of its
# own.
third-party:
	@scripts/setup build
	@set -e; for options in "$(AVR)" "$(AVR_328P)"; do \
		cargo build $$options -p third-party-mcp2515-crate -p third-party-mcp25xx-crate; \
		cargo build $$options -p third-party-mcp25xx-wrong-rxb1; \
	done

# The prerequisites do not depend on each other.
test: export CARGO_BUILD_WARNINGS := deny
test: setup
	@$(MAKE) --no-print-directory -j2 --output-sync=line lint-firmware deny firmwares third-party $(VENV)/gui $(TOOLS)/bin/ravedude
	@$(MAKE) --no-print-directory test-packages test-library test-host test-bounds test-firmware test-uno test-clients

# The crates that crates.io gets. Each builds from its package alone, with the packages of the
# others: in one call, because none has to be there yet.
PUBLISHED := can-frame sim-base can-model mcp2515-model mcp2515-ordered dronecan-wire
test-packages:
	cargo package --quiet --locked --offline --allow-dirty $(addprefix -p ,$(PUBLISHED))

# A call for each: cargo unites features over the packages and targets of a call. The unit tests
# need no simulator, so they build in seconds. Below, "bridge" and "rig" are only named so that the
# crates below the simulator have the same features in all calls: cargo builds the simulator once.
test-library:
	@set -e; for features in $(PRESETS); do \
		options="-p servo-node --lib $$(scripts/firmware --cargo $$features)"; \
		echo "cargo test $$options"; $(ON_BOARD) cargo test $$options; \
	done

test-host:
	cargo test -p boot -p bounds -p bridge -p fuzz-harness -p mcp2515-ordered -p dronecan-wire -p dronecan-host -p can-frame -p sim-base -p can-model -p mcp2515-model \
		-p bus-load -p can-link -p node-update -p avr-chip -p avr-model -p bench -p sim -p rig

# They run the program that is in target/firmware, so it must be of these sources.
# TEST_FILES= chooses files of tests/boards.
BOARD_TESTS = cargo test -p tests -p bridge --test boards --
FILES := $(patsubst tests/boards/%.rs,%,$(filter-out %/main.rs,$(wildcard tests/boards/*.rs)))
TEST_FILES := $(FILES)
test-firmware: firmware
	$(if $(filter-out $(FILES),$(TEST_FILES)),$(error tests/boards has no $(filter-out $(FILES),$(TEST_FILES))))
	$(ON_BOARD) $(BOARD_TESTS) $(if $(filter-out $(TEST_FILES),$(FILES)),$(addsuffix ::,$(TEST_FILES))) $(LONG_TESTS)

# The same tests for the boards with an ATmega328P.
test-uno:
	NODE_BOARD=uno NODE_SHIELD=seeed $(BOARD_TESTS) $(addsuffix ::,$(ON_UNO)) $(LONG_TESTS)

# They mostly wait for real time. Their node is on the default board.
CLIENTS := not long
test-clients:
	cargo build -p node-update
	$(VENV)/bin/python -m pytest -q -n 4 --dist loadfile -m '$(CLIENTS)' tests/clients

# The page in Chromium, and seconds of the cross-check: a job of its own in CI, because WebAssembly
# compiles for two minutes. WEB_TESTS=--long adds the long tests.
test-web: web-page
	@scripts/setup browser
	cd web && node_modules/.bin/tsc
	node --test web/check/serve.mjs
	CROSS_SECONDS=$(or $(CROSS_SECONDS),5) cargo test -p web
	node web/check/page.mjs '$(TARGET_DIR)/web' $(WEB_TESTS)

# The long tests, one after the other. Append new ones.
LONG := reliability elf-mutants fuzz fuzz-coverage soak
WITHOUT_THESIS = LONG_TESTS='--include-ignored --skip thesis::'
test-all: test lint
	@$(MAKE) --no-print-directory test-library PRESETS=full BOARD=uno SHIELD=module
	@# The tests that take long, on the default board, and all on the boards with the other chip.
	$(BOARD_TESTS) --ignored
	@# The preset without a serial monitor, which most tests read.
	NODE_ELF=$$(scripts/firmware --path remote) $(BOARD_TESTS) load::
	@# Except the tests of the thesis, whose node was an ATmega168.
	@$(MAKE) --no-print-directory firmwares test-firmware BOARD=uno SHIELD=seeed $(WITHOUT_THESIS)
	@$(MAKE) --no-print-directory firmwares test-firmware BOARD=uno SHIELD=module $(WITHOUT_THESIS)
	@$(MAKE) --no-print-directory test-boards
	@$(MAKE) --no-print-directory build-twice
	@$(MAKE) --no-print-directory test-clients CLIENTS=long
	@# A minute of the cross-check, with the same traffic in Node.js and in a browser.
	@$(MAKE) --no-print-directory test-web WEB_TESTS=--long CROSS_SECONDS=60
	@$(MAKE) --no-print-directory cross-check CROSS_SECONDS=60 CROSS_BROWSER=1
	@# Without the feature that the other packages ask for.
	cargo test -p mcp2515-ordered
	@set -e; for target in $(LONG); do echo "make $$target"; $(MAKE) --no-print-directory $$target; done

# Every board and CAN board of the table links.
test-boards:
	@scripts/setup build
	@scripts/firmware --every-board
	@scripts/boot --every-board

fuzz: firmware
	FUZZ_FRAMES=1000000 $(BOARD_TESTS) fuzz:: --nocapture

# New inputs stay in the target directory; tests/fuzz/corpus is only read. See docs/fuzzing.md.
FUZZED := node commanders eeprom host sim bridge
TIME := 60
MUTANTS = $(TOOLS)/bin/cargo-mutants mutants --jobs 2 --timeout 60 --build-timeout 100
fuzz-coverage: $(TOOLS)/bin/cargo-fuzz
	@set -e; for target in $(FUZZED); do \
		found=$(abspath $(TARGET_DIR))/fuzz/corpus/$$target; \
		mkdir -p $$found; \
		$(abspath $<) run --fuzz-dir tests/fuzz --target-dir $(abspath $(TARGET_DIR))/fuzz -s none $$target \
			$$found tests/fuzz/corpus/$$target -- -max_total_time=$(TIME) -max_len=2048 -timeout=20 -print_final_stats=1; \
	done

soak: firmware
	@scripts/boot $(WIRING)
	SOAK_HOURS=$(HOURS) SOAK_SEED=$(SEED) cargo bench --bench soak

setup:
	@scripts/setup test

$(VENV)/installed: tests/clients/requirements.txt tests/clients/requirements-alone.txt
	@echo "Installing pydronecan, pymavlink, MAVProxy and python-can into $(VENV): half a minute"
	python3 -m venv $(VENV)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check -r $<
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --no-deps -r tests/clients/requirements-alone.txt
	touch $@

# Apart, because only tests use it, and it takes more than all the others.
$(VENV)/gui: tests/clients/requirements-gui.txt $(VENV)/installed
	@echo "Installing the DroneCAN GUI Tool into $(VENV): 0.3 GB"
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --no-deps -r $<
	touch $@

# "make test" denies warnings in all that it builds: what clippy does not see is what a set with
# fewer features does not use. Clippy of the host programs checks all their dependencies once more,
# three minutes from an empty target directory, so "make test-all" does that.
lint: lint-firmware
	cargo clippy --workspace --all-targets -- -D warnings
	cargo clippy -p web --target wasm32-unknown-unknown -- -D warnings

lint-firmware: setup
	cargo fmt --all --check
	cargo fmt --manifest-path tests/fuzz/Cargo.toml --check
	scripts/drawings --check
	scripts/lint
	scripts/docs
	scripts/elf-mutants --check
	scripts/wiring-page --check
	cargo clippy --target thumbv6m-none-eabi -p dronecan-wire -p mcp2515-ordered -- -D warnings
	cargo clippy $(AVR) -p servo-node --bin servo-node -- -D warnings
	cargo clippy $(AVR) -p servo-node --bin servo-node --features full -- -D warnings
	cargo clippy $(AVR) -p servo-node --bin servo-node $$(scripts/firmware --cargo remote) -- -D warnings
	NODE_BOARD=uno NODE_SHIELD=module cargo clippy $(AVR_328P) -p servo-node --bin servo-node --features full -- -D warnings
	cargo clippy $(AVR) -p boot -- -D warnings
	cargo clippy $(AVR) -p third-party-mcp2515-crate -p third-party-mcp25xx-crate -- -D warnings
	cargo clippy $(AVR) -p third-party-mcp25xx-wrong-rxb1 -- -D warnings

# .cargo/deny.toml says what is allowed. The fuzz targets are a workspace of their own.
DENY = $(TOOLS)/bin/cargo-deny --locked --config .cargo/deny.toml
deny: $(TOOLS)/bin/cargo-deny
	$(DENY) --workspace check licenses sources
	$(DENY) --workspace --exclude-dev check -A unused-wrapper bans
	$(DENY) --manifest-path tests/fuzz/Cargo.toml check -A unused-wrapper licenses sources bans

# Known vulnerabilities of the dependencies. It clones https://github.com/rustsec/advisory-db, so
# "make test" leaves it out.
advisories: $(TOOLS)/bin/cargo-deny
	$(DENY) --workspace check advisories
	$(DENY) --manifest-path tests/fuzz/Cargo.toml check advisories

# The pages are of the default preset.
bench: firmware third-party
	$(if $(filter-out default,$(FEATURES)),NODE_ELF=$(ELF)) cargo bench --bench timing
	@$(MAKE) --no-print-directory losses bounds-page

# The pictures of docs/web.md and the README, from Chromium.
web-pictures: web-page
	@scripts/setup browser
	@node web/check/page.mjs '$(TARGET_DIR)/web' --pictures docs/img

# Of every program for the chip of BOARD. A flood takes MINUTES of simulated time.
losses:
	@scripts/firmware default remote thesis
	@scripts/firmware $(UNO) full
	$(ON_BOARD) MINUTES='$(MINUTES)' WHY='$(WHY)' ONLY='$(ONLY)' cargo bench --bench loss

# Mistakes in the sources that the host's unit tests must notice: .cargo/mutants.toml says in which
# files, and what is left out. It takes hours.
mutants: $(TOOLS)/bin/cargo-mutants
	@# All features, or what is not compiled would survive. Of the node the unit tests only,
	@# without the slow ones of a module that is not changed.
	$(MUTANTS) -p servo-node --features full --cargo-arg=--lib --output $(TARGET_DIR)/mutants/node $(ARGS) -- -- --skip monitor::lines::tests
	$(MUTANTS) -p dronecan-wire -p mcp2515-ordered --all-features --output $(TARGET_DIR)/mutants/crates $(ARGS)

# Mistakes in the firmware that the tests on simulated boards must notice.
elf-mutants: setup
	@scripts/setup build
	scripts/elf-mutants

reliability: firmware
	cargo bench --profile dev --bench reliability

# The tables of docs/budget.md.
budget:
	@scripts/setup build
	@scripts/budget-page

# docs/wiring.md, and the drawing of the README.
wiring:
	@scripts/wiring-page

drawings:
	@scripts/drawings

bounds: firmware
	@scripts/bounds $(WIRING) '$(FEATURES)'

# Beside what the simulator observes, in docs/benchmarks.md.
bounds-page:
	@scripts/boot
	@scripts/boot $(UNO)
	@scripts/firmware default remote thesis
	@scripts/firmware $(UNO) full
	cargo bench --bench bounds

# The presets and the bootloaders of both chips, and the feature with one more interrupt.
test-bounds:
	scripts/bounds $(SHIPPED)
	scripts/bounds $(UNO) full default outputs,rpm
	scripts/bounds --boot
	scripts/bounds $(UNO) --boot

size: firmware
	@avr-nm --size-sort --reverse-sort --print-size --radix=d $(ELF) | grep -i ' [tbdv] ' | c++filt -s rust | head -40

# A wrong port ends it before anything is installed or built.
flash:
	@scripts/flash --check --port '$(PORT)' $(WIRING) '$(FEATURES)'
	@scripts/setup flash
	@$(MAKE) --no-print-directory firmware $(TOOLS)/bin/ravedude
	@scripts/flash --port '$(PORT)' $(WIRING) '$(FEATURES)'

# Optimisation and information for debuggers would only make the tools take longer to compile.
INSTALL := CARGO_PROFILE_DEV_DEBUG=false cargo install --quiet --debug --locked --root $(TOOLS)
$(TOOLS)/bin/ravedude:
	@scripts/setup flash
	@echo "Installing ravedude"
	@$(INSTALL) ravedude --version 0.2.2

$(TOOLS)/bin/cargo-about:
	@scripts/setup build
	@echo "Installing cargo-about: a minute on two cores"
	@$(INSTALL) cargo-about --version 0.9.3 --features cli

$(TOOLS)/bin/cargo-deny:
	@scripts/setup build
	@echo "Installing cargo-deny: half a minute on two cores"
	@$(INSTALL) cargo-deny --version 0.20.2

$(TOOLS)/bin/cargo-mutants: | setup
	@scripts/setup build
	@echo "Installing cargo-mutants"
	@$(INSTALL) cargo-mutants --version 27.1.0

$(TOOLS)/bin/cargo-fuzz:
	@scripts/setup fuzz
	@echo "Installing cargo-fuzz"
	@$(INSTALL) cargo-fuzz --version 0.13.2

clean:
	cargo clean
	rm -rf $(VENV) web/node_modules
