# What users and CI do here. "make sim" and "make test" are all it takes on a fresh machine.
SHELL := /bin/bash
.DELETE_ON_ERROR:
# Or cargo would look for make's jobs. A call of make below has the words from the environment.
unexport MAKEFLAGS MFLAGS
SUB := $(MAKE) --no-print-directory
SIDE_BY_SIDE := $(SUB) -j

TARGET_DIR := $(or $(CARGO_TARGET_DIR),target)
AVR := --config avr-specs/firmware.toml --profile firmware --target avr-specs/avr-atmega168.json
AVR_328P := $(subst 168,328p,$(AVR))
# Board, CAN board (avr-specs/boards.toml) and wires of one's own. Empty: the table's default.
WIRING := --board '$(BOARD)' --shield '$(SHIELD)' --cs '$(CS)' --int '$(INT)' --crystal '$(CRYSTAL)'
# The same as words of make.
SAME := $(foreach word,BOARD SHIELD CS INT CRYSTAL FEATURES,$(if $($(word)),$(word)=$($(word))))
# Silent, because the script that builds the firmware prints what is wrong.
ELF_OF = $(shell scripts/firmware --path $(WIRING) $(1) 2>/dev/null)
ELF = $(call ELF_OF,$(FIRMWARE_FOR) '$(FEATURES)')
SHIPPED := default remote thesis
UNO := --board uno --shield seeed
UNO_MODULE := --board uno --shield module
VENV := .venv
# Programs for this machine, and the directory in whose bin "make install" puts them.
PROGRAMS := $(abspath $(TARGET_DIR))/release
PREFIX ?= $(or $(CARGO_INSTALL_ROOT),$(CARGO_HOME),$(HOME)/.cargo)
TOOLS := $(TARGET_DIR)/tools

# The words of users, and of tests. Make ignores a misspelt one: it would build for another board.
WORDS := BOARD SHIELD CS INT CRYSTAL FEATURES PORT ARGS PREFIX NODE BUS FILE PROGRAMMER STOCK WEB_PORT \
	WEB_HOST HOURS SEED TIME PROCESSOR MINUTES WHY ONLY REV AVR_HAL FUZZ_SEED CROSS_SECONDS CROSS_SEED \
	CROSS_BROWSER
OTHER_WORDS := PROGRAMS PRESETS SHIPPED ON_UNO TEST_FILES TEST_OPTIONS CLIENTS WEB_TESTS CHROMIUM CARGO_% \
	FUZZ_% JUDGE_% NODE_%
$(foreach name,$(.VARIABLES),$(if $(findstring command line,$(origin $(name))),$(if \
	$(filter $(WORDS) $(OTHER_WORDS),$(name)),,$(error $(name)= is wrong. make has the words $(WORDS)))))

.PHONY: $(shell sed -n 's/^\([a-z][a-z-]*\):.*/\1/p' Makefile)
define HELP
make sim        watch the node work on a simulated board and CAN bus     ARGS="--for 5s"
make web        the same in a web page, served on this machine           WEB_PORT=8000
make bridge     the node as a ground station sees it, through MAVLink
make install    the commands sim, bridge, node-update, node-check ...    PREFIX=/usr/local
make firmware   build the firmware, and print its size
make flash      upload it to an Arduino, and open its serial monitor     PORT=/dev/ttyUSB0
make bootloader write the loader for updates over the bus to an Arduino  PROGRAMMER=usbasp
make update     send the firmware to nodes over the bus                  NODE=120 BUS=slcan:/dev/ttyACM0
make check      check a real board: ten minutes, and a report            NODE=120 BUS=slcan:/dev/ttyACM0
make test       what CI runs; installs what is missing first
make help-all   everything else

BOARD=uno SHIELD=module   for another board: a wrong name lists the right ones. Wires: CS=D8 INT=D2 CRYSTAL=8
FEATURES=full             another preset: default, full, remote, thesis; or features with commas between them
endef
help:
	$(info $(HELP))@:
## this list: of each target the lines above it that begin with ##
help-all:
	@awk -F: '/^## / { text = text (text ? "\n                    " : "") substr($$0, 4) } \
		/^[a-z]/ && text { printf "make %-14s %s\n", $$1, text; text = "" }' Makefile
setup-%: # what this machine lacks
	@scripts/setup $*

# --- The node on a simulated board

# Compilers print on stderr, so that stdout has only the output of the program. Cargo has a lock for
# each profile, so firmware and simulator do not wait for each other.

## the firmware on a simulated board and CAN bus; two minutes the first time  (ARGS="--for 5s")
sim:
	@$(SIDE_BY_SIDE) firmware program-sim >&2
	@NODE_ELF=$(ELF) $(PROGRAMS)/sim $(ARGS)
## the same, waiting for avr-gdb on port 3333
gdb:
	@scripts/setup gdb >&2
	@FIRMWARE_FOR=--gdb $(SIDE_BY_SIDE) firmware program-sim >&2
	@NODE_ELF=$(call ELF_OF,--gdb '$(FEATURES)') $(PROGRAMS)/sim --plain --gdb 3333 $(ARGS)
## what a ground station sees of the node through MAVLink: simulator and bridge
bridge:
	@scripts/setup bridge >&2
	@$(SIDE_BY_SIDE) firmware $(VENV)/installed program-sim >&2
	@$(SUB) program-bridge >&2
	@NODE_ELF='$(abspath $(ELF))' $(VENV)/bin/python scripts/bridge-demo $(WIRING) $(ARGS)
# One call after the other, so that cargo builds for one what it has built for the other.
program-%: setup-build
	@test $* != sim || test -e $(PROGRAMS)/sim || \
		echo "Compiling the simulator: two minutes on two cores the first time"
	@cargo build --release -p $*

## the web page in target/web in which the firmware runs on a simulated board and bus, served: four
## minutes the first time  (WEB_PORT=8000; WEB_HOST=0.0.0.0 for others, too)
web: setup-web
	@scripts/web
	@node web/serve.mjs '$(TARGET_DIR)/web' $(or $(WEB_PORT),0) $(WEB_HOST)

# Offline: all has been compiled, and cargo would look for newer crates.
## sim, bridge, node-update, node-check and avr-bounds in ~/.cargo/bin, with man pages and completions
## (PREFIX=/usr/local)
install: firmware
	@$(SUB) program-sim program-bridge program-node-tools
	@set -e; for path in sim host/bridge host/tools crates/avr-bounds; do \
		cargo install --quiet --locked --offline --root '$(PREFIX)' --path $$path; done
	@cargo run --quiet --release --locked -p sim --example manuals -- '$(PREFIX)/share'
	@echo "Installed sim, bridge, node-update, node-check and avr-bounds in $(PREFIX)/bin$$( \
		case ":$$PATH:" in *:'$(PREFIX)/bin':*) ;; *) echo ", which is not in PATH yet";; esac)"
	@$(if $(BOARD)$(SHIELD)$(FEATURES),echo "sim without --elf simulates the default firmware. For this \
		one: sim --elf '$(abspath $(ELF))'")

# --- The firmware, and real boards

## the firmware in target/firmware, and its size
firmware: setup-build
	@test -e $(ELF) || echo "Compiling the firmware: a minute on two cores the first time"
	@scripts/firmware $(FIRMWARE_FOR) $(WIRING) '$(FEATURES)'
## the bootloader, for updates over the bus (docs/update.md)
boot: setup-build
	@scripts/boot $(WIRING)

# A wrong port or word ends these two before anything is installed or built.

## upload the firmware to an Arduino, and open its serial monitor  (PORT=/dev/ttyUSB0)
flash:
	@scripts/flash --check --port '$(PORT)' $(WIRING) '$(FEATURES)'
	@scripts/setup flash
	@$(SUB) firmware $(TOOLS)/bin/ravedude
	@scripts/flash --port '$(PORT)' $(WIRING) '$(FEATURES)'
BOOTLOADER = scripts/bootloader $(WIRING) --programmer '$(PROGRAMMER)' --port '$(PORT)' \
	$(if $(STOCK),--stock '$(STOCK)')
## write the bootloader with a programmer  (PROGRAMMER=usbasp; STOCK=file.hex restores the board's own)
bootloader:
	@$(BOOTLOADER) --check
	@$(SUB) boot
	@scripts/setup flash
	@$(BOOTLOADER)

BIT_RATE = $(if $(findstring --bitrate,$(ARGS)),,--bitrate $(shell scripts/firmware --bit-rate $(WIRING)))
# Without FILE= the firmware of the board, with a preset that can be updated over the bus again.
UPDATED = $(or $(FEATURES),$(shell scripts/firmware --update-preset $(WIRING) 2>/dev/null))
UPDATE = $(or $(FILE),$(patsubst %.elf,%.bin,$(call ELF_OF,'$(UPDATED)')))
FAIL = { echo '$(1)' >&2; exit 2; }
EXAMPLE := $(strip $(SAME) NODE=120) BUS=$(or $(BUS),slcan:/dev/ttyACM0)
## send the firmware to nodes over the bus
## (NODE=120 BUS=slcan:/dev/ttyACM0; NODE=all, FILE=other.bin)
update:
	@test '$(BUS)' || $(call FAIL,Say which bus: make update $(EXAMPLE))
	@test '$(NODE)' || $(call FAIL,Say which node: make update $(EXAMPLE) or NODE=all)
	@test -z '$(FILE)' || test -r '$(FILE)' || $(call FAIL,FILE=$(FILE) is no file that you can read)
	$(if $(FILE),,@$(SUB) firmware FEATURES='$(UPDATED)')
	@$(SUB) program-node-tools
	@$(PROGRAMS)/node-update '$(UPDATE)' --bus '$(BUS)' --node '$(NODE)' $(BIT_RATE) $(ARGS)
# It offers an update with the program that the node has, if that has been built here.
## check a real board, and write a report for an issue: ten minutes
## (NODE=120 BUS=slcan:/dev/ttyACM0; PORT=/dev/ttyUSB0 if there is one)
check:
	@test '$(BUS)' || $(call FAIL,Say which bus: make check $(EXAMPLE) PORT=/dev/ttyUSB0)
	@$(SUB) program-node-tools
	@$(PROGRAMS)/node-check --bus '$(BUS)' --node '$(or $(NODE),120)' $(if $(PORT),--port '$(PORT)') \
		--report '$(TARGET_DIR)/check' $(BIT_RATE) \
		$(foreach file,$(wildcard $(TARGET_DIR)/firmware/*.bin),--firmware '$(file)') $(ARGS)

## a release in target/dist: ten minutes; of one board two  (BOARD=uno SHIELD=module; ARGS=--twice: check
## that two builds of the last commit have the same bytes)
dist: setup-build $(TOOLS)/bin/cargo-about
	@scripts/dist $(WIRING) $(ARGS)
## prove stack and cycles of the firmware from its machine code (crates/avr-bounds)
bounds: firmware
	@scripts/bounds $(WIRING) '$(FEATURES)'

# --- Tests

# The clients mostly wait for real time, so what only computes runs beside them and gives way: by 5
# it gets a third of what another program gets. By 10 it would get a tenth.
GIVE_WAY := nice -n 5
PARTS := test-clients test-firmware test-host test-library sources
## what CI runs, except the page; seven to nine minutes on two cores
test: setup-test
	@CARGO_BUILD_WARNINGS=deny $(SIDE_BY_SIDE)3 $(PARTS)

## the programs that the tests run
firmwares: third-party
	@set -e; for board in "" "$(UNO)" "$(UNO_MODULE)"; do scripts/boot $$board; done
	@scripts/firmware $(SHIPPED)
	@scripts/firmware --gdb
	@scripts/firmware $(UNO) full default tunnel relay rpm outputs,rpm
	@scripts/firmware $(UNO_MODULE) full
	$(if $(BOARD)$(SHIELD),@scripts/firmware $(WIRING) '' $(SHIPPED) && scripts/boot $(WIRING))
## programs on the drivers of others (docs/sketch.md)
third-party: setup-build
	@set -e; for options in "$(AVR)" "$(AVR_328P)"; do cargo build $$options -p third-party; done
# All are in each call: so cargo builds the simulator with one set of features, once.
TESTED := $(addprefix -p ,avr-bounds boot bridge fuzz-harness mcp2515-ordered dronecan-wire \
	dronecan-host can-frame own-node sim-base can-model mcp2515-model node-tools \
	avr-core avr-model bench sim tests)
test-programs: setup-simavr
	cargo test --no-run $(TESTED)
	cargo test --no-run $(TESTED) --test boards --test judge
## tests of the crates and programs, bounds of the firmwares, and the pages with their sizes
test-host: test-programs firmwares
	$(GIVE_WAY) cargo test $(TESTED)
	$(GIVE_WAY) cargo test $(TESTED) -p web --test engines
	export AVR_BOUNDS='$(abspath $(TARGET_DIR))/debug/avr-bounds'; $(GIVE_WAY) scripts/bounds && \
		$(GIVE_WAY) scripts/bounds --boot && $(GIVE_WAY) scripts/bounds $(UNO) full
	$(GIVE_WAY) cargo test $(TESTED) --test judge -- --nocapture
	scripts/docs --measured || true
	scripts/budget-page --check

# The unit tests of the node need no simulator. "make test-long" has sets with the other features.
PRESETS := default full
# The board of the tests.
ON_BOARD := NODE_BOARD='$(BOARD)' NODE_SHIELD='$(SHIELD)'
# The processor of what runs for hours, on which the tests on boards run, too: PROCESSOR=simavr for the other.
ON_CORE := NODE_PROCESSOR='$(or $(PROCESSOR),own)'
## unit tests of the node  (PRESETS="default full")
test-library: setup-build
	@set -e; for features in $(PRESETS); do \
		options="-p servo-node --lib $$(scripts/firmware --cargo $$features)"; echo "cargo test $$options"; \
		$(ON_BOARD) $(GIVE_WAY) cargo test $$options; done
# They run the programs in target/firmware.
BOARD_TESTS = $(GIVE_WAY) cargo test $(TESTED) --test boards --
FILES := $(patsubst tests/boards/%.rs,%,$(filter-out %/main.rs,$(wildcard tests/boards/*.rs)))
TEST_FILES := $(FILES)
IS_PART = $(filter-out $(TEST_FILES),$(FILES))
# On an Uno those in which eight outputs or the size matter. CI runs all on this board in a job of its own.
ON_UNO := bounds::it_is_proved budget:: full_bus:: restart:: servo::
## tests of the firmware on simulated boards  (TEST_FILES="parameters budget" of tests/boards; BOARD=uno)
test-firmware: $(if $(IS_PART),firmware,firmwares test-programs)
	$(if $(filter-out $(FILES),$(TEST_FILES)),$(error tests/boards has no $(filter-out $(FILES),$(TEST_FILES))))
	$(ON_BOARD) $(BOARD_TESTS) $(if $(IS_PART),$(addsuffix ::,$(TEST_FILES))) $(TEST_OPTIONS)
	$(if $(IS_PART)$(BOARD)$(SHIELD)$(TEST_OPTIONS),,NODE_BOARD=uno NODE_SHIELD=seeed $(BOARD_TESTS) $(ON_UNO))
# The test of the clients runs what this leaves.
## own-node on an Uno and a Diecimila with arduino-hal: build, bounds, tests
## (AVR_HAL=path of a clone of avr-hal)
own-node-uno: test-programs $(VENV)/installed
	@AVR_HAL='$(AVR_HAL)' scripts/own-node-uno
	cargo test -p bench --test all -- --ignored own_node_uno::
	$(VENV)/bin/python -m pytest -q tests/clients/test_own_node_uno.py
## other programs on the simulated bus: pydronecan, the GUI Tool, MAVProxy, avrdude ...
test-clients: setup-test test-programs firmwares $(VENV)/gui $(TOOLS)/bin/ravedude
	@AVR_HAL='$(AVR_HAL)' $(GIVE_WAY) scripts/own-node-uno --if-reachable
	$(VENV)/bin/python -m pytest -q -n 6 --dist worksteal -m '$(or $(CLIENTS),not long)' tests/clients
IS_LONG = $(findstring --long,$(WEB_TESTS))
## the web page in Chromium, and its processor against simavr: twenty minutes the first time
## (WEB_TESTS=--long)
test-web: setup-browser
	scripts/web
	cd web && node_modules/.bin/tsc
	node --test web/check/serve.mjs
	CROSS_SECONDS=$(or $(CROSS_SECONDS),$(if $(IS_LONG),60,5)) cargo test -p web
	cargo build -p sim
	set -e; for tests in page board bus; do node web/check/$$tests.mjs '$(TARGET_DIR)/web' $(WEB_TESTS); done
	$(if $(IS_LONG),$(SUB) cross-check CROSS_SECONDS=60 CROSS_BROWSER=1)

# The programs for boards of crates/own-node: a workspace of their own.
BOARDS := --manifest-path crates/own-node/boards/Cargo.toml
RP2040 := $(BOARDS) --target-dir $(TARGET_DIR)/boards -p own-node-rp2040 --target thumbv6m-none-eabi
STM32F103 := $(BOARDS) --target-dir $(TARGET_DIR)/boards -p own-node-stm32f103 --target thumbv7m-none-eabi
## check formatting, the length of lines and functions, and that documents agree with the sources
sources: setup-build
	cargo fmt --all --check
	cargo fmt --manifest-path tests/fuzz/Cargo.toml --check
	cargo fmt $(BOARDS) -p own-node-rp2040 -p own-node-stm32f103 --check
	cargo fmt --manifest-path crates/own-node/boards/uno/Cargo.toml --check
	scripts/lint
	scripts/docs
	set -e; for page in elf-mutants wiring-page release-page; do scripts/$$page --check; done
PROGRAM := -p servo-node --bin servo-node
PUBLISHED := avr-core avr-bounds can-frame sim-base can-model mcp2515-model mcp2515-ordered dronecan-wire
# First the Python: names that are not defined or not used. Clippy, for both targets. Then the published
# crates with a stable Rust and the oldest one that they promise, also for a Cortex-M0, with their
# documentation, and own-node on its boards. Last, cargo packs each published crate and builds it from
# its package. In one call, so that a package finds the others before crates.io has them, and in a new
# directory: in one that it knows cargo keeps what it has unpacked, whatever changed since.
## "make sources", ruff, clippy with warnings as errors, and the published crates with other versions of Rust
lint: setup-test sources $(VENV)/installed
	$(VENV)/bin/ruff check --no-cache --select F,E9 tests/clients scripts/*.py \
		$$(git grep -l '^.!.*python3' scripts)
	cargo clippy --target thumbv6m-none-eabi -p dronecan-wire -p mcp2515-ordered -- -D warnings
	set -e; for board in "$(RP2040)" "$(STM32F103)"; do cargo clippy $$board -- -D warnings; done
	set -e; for preset in default remote full; do \
		cargo clippy $(AVR) $(PROGRAM) $$(scripts/firmware --cargo $$preset) -- -D warnings; done
	cargo clippy $(AVR) -p boot -p third-party -- -D warnings
	NODE_BOARD=uno NODE_SHIELD=module cargo clippy $(AVR_328P) $(PROGRAM) --features full -- -D warnings
	cargo clippy --workspace --all-targets -- -D warnings
	cargo clippy -p web -p dronecan-host -p node-tools --lib --target wasm32-unknown-unknown \
		-- -D warnings
	rustup toolchain install --profile minimal --target thumbv6m-none-eabi,thumbv7m-none-eabi 1.88
	rustup run stable rustc --version || rustup toolchain install --profile minimal stable
	cargo +1.88 check --locked --target thumbv6m-none-eabi -p mcp2515-ordered -p dronecan-wire
	set -e; for board in "$(RP2040)" "$(STM32F103)"; do cargo +1.88 build --locked $$board; done
	set -e; for rust in 1.88 stable; do cargo +$$rust check --locked $(addprefix -p ,$(PUBLISHED)); done
	RUSTDOCFLAGS="-D warnings" cargo +stable doc --locked --no-deps --all-features \
		$(addprefix -p ,$(PUBLISHED)) -p dronecan-host
	dir=$$(mktemp -d); trap 'rm -rf $$dir' EXIT; \
		CARGO_TARGET_DIR=$$dir cargo publish --quiet --workspace --dry-run --locked --allow-dirty
SINCE := $(or $(REV),074a40c)
## what changed in the published crates since a commit, against their version numbers
## (REV= a commit; without it the last one of 2.1, which has no tag)
semver: $(TOOLS)/bin/cargo-semver-checks
	@git cat-file -e "$(SINCE)^{commit}"
	PATH="$(abspath $(TOOLS))/bin:$$PATH" cargo semver-checks --baseline-rev $(SINCE) \
		$(foreach crate,$(PUBLISHED),$(if $(shell git ls-tree $(SINCE) crates/$(crate)),-p $(crate)))

DENY = $(TOOLS)/bin/cargo-deny --locked --config .cargo/deny.toml
OTHER_WORKSPACES := tests/fuzz crates/own-node/boards
## licences and origins of all dependencies, and that only the simulator links simavr
## (ONLY=advisories: their known vulnerabilities, from https://github.com/rustsec/advisory-db)
deny: $(TOOLS)/bin/cargo-deny
	$(if $(ONLY),,$(DENY) --workspace check licenses sources)
	$(if $(ONLY),,$(DENY) --workspace --exclude-dev check -A unused-wrapper bans)
	set -e; for one in $(if $(ONLY),.) $(OTHER_WORKSPACES); do $(DENY) --manifest-path $$one/Cargo.toml \
		check $(or $(ONLY),-A unused-wrapper licenses sources bans); done

# --- Long tests, and what writes documents

# scripts/release-page runs them one by one.
## "make test" and "make test-web" on more boards, and the long tests below: hours
test-all:
	@$(SUB) test
	@$(SUB) lint
	@$(SUB) deny
	@$(SUB) test-long
	@$(SUB) test-long BOARD=uno
	@$(SUB) test-web WEB_TESTS=--long
	@$(SUB) dist
	@$(SUB) dist ARGS=--twice
	@$(SUB) judge
	@$(SUB) reliability
	@$(SUB) elf-mutants
	@$(SUB) fuzz
	@$(SUB) fuzz-coverage
	@$(SUB) soak
# Proofs count cycles of the processor, and edges are compared to the cycle, which a time of 62.5 ns
# cannot; the third one needs requests in one phase.
NOT_AT_CORNERS := --skip bounds:: --skip each_edge_is_exact --skip a_request_that_nobody_acknowledges
# The preset "remote" has no serial monitor, which most tests read. Alone, mcp2515-ordered is built
# without the feature that the other packages ask for.
define TEST_LONG
$(BOARD_TESTS) --ignored
$(SUB) test-library PRESETS='thesis escs,masks,relay,rpm,tunnel,values'
scripts/bounds remote thesis
scripts/bounds $(UNO) default outputs,rpm
scripts/bounds $(UNO) --boot
set -e; for corner in slow fast worst random:7; do export NODE_CORNER=$$corner; \
	$(BOARD_TESTS) $(NOT_AT_CORNERS); $(SUB) test-clients CLIENTS='at_corners and not long'; done
NODE_ELF=$$(scripts/firmware --path remote) $(BOARD_TESTS) load::
cargo test -p mcp2515-ordered -- --include-ignored
$(SUB) test-clients CLIENTS=long
endef
# The node of the thesis was an ATmega168.
define TEST_LONG_ON_BOARD
$(SUB) test-library PRESETS='full remote' SHIELD=module
set -e; for shield in seeed module; do \
	$(SUB) test-firmware SHIELD=$$shield TEST_OPTIONS='--include-ignored --skip thesis::'; done
endef
## tests that take longer than those of "make test", or "make test" on another board  (BOARD=uno)
test-long: $(if $(BOARD),,firmwares test-programs)
	$(if $(BOARD),$(TEST_LONG_ON_BOARD),$(TEST_LONG))
## the firmware on simavr, on avr-core and in WebAssembly, compared
## (CROSS_SECONDS=60, CROSS_SEED=7; CROSS_BROWSER=1 in Chromium)
cross-check: $(if $(CROSS_BROWSER),setup-browser,setup-web setup-simavr)
	@scripts/web
	cargo test -p web --test cross_check -- --nocapture
	CROSS_SECONDS=$(or $(CROSS_SECONDS),9) cargo test -p web --test engines -- --nocapture
	cargo test -p bench --test all -- --ignored opcodes::
## what "make bounds" proves of random programs, against runs of them: half an hour  (SEED=7)
judge: setup-test
	JUDGE_SECONDS=1800 JUDGE_SEED=$(or $(SEED),$$(date +%s)) \
		cargo test $(TESTED) --test judge -- --nocapture
## a million random and mutated frames and transfers  (FUZZ_SEED=1 for others)
fuzz: setup-simavr firmware
	$(ON_CORE) FUZZ_FRAMES=1000000 $(BOARD_TESTS) fuzz:: --nocapture
# New inputs stay in the target directory; tests/fuzz/corpus is only read. Only an Uno has "full".
FUZZ := $(abspath $(TARGET_DIR))/fuzz
## the parsers in libFuzzer, a minute each  (TIME=900)
fuzz-coverage: $(TOOLS)/bin/cargo-fuzz
	@set -e; for target in node commanders eeprom host sim bridge; do found=$(FUZZ)/corpus/$$target; \
		mkdir -p $$found; NODE_BOARD=uno NODE_SHIELD=seeed $(abspath $<) run --fuzz-dir tests/fuzz \
			--target-dir $(FUZZ) -s none $$target $$found tests/fuzz/corpus/$$target -- \
			-max_total_time=$(or $(TIME),60) -max_len=2048 -timeout=20 -print_final_stats=1; done
## a node with random faults for an hour; Ctrl-C ends it with a summary  (HOURS=4, SEED=7, BOARD=uno)
soak: setup-simavr firmware boot
	$(ON_BOARD) $(ON_CORE) SOAK_HOURS=$(HOURS) SOAK_SEED=$(SEED) cargo bench --bench soak
# All features, or what is not compiled would survive. .cargo/mutants.toml leaves out slow tests.
MUTANTS = $(TOOLS)/bin/cargo-mutants mutants --jobs 2 --timeout 60 --build-timeout 100 $(ARGS)
## put mistakes into the sources that the unit tests must notice, or the tests on boards: hours
mutants: $(TOOLS)/bin/cargo-mutants
	$(MUTANTS) -p servo-node --features full --cargo-arg=--lib --output $(TARGET_DIR)/mutants/node \
		-- -- --skip monitor::lines::tests
	$(MUTANTS) -p dronecan-wire -p mcp2515-ordered --all-features --output $(TARGET_DIR)/mutants/crates
## put mistakes into the firmware that the tests on simulated boards must notice
elf-mutants: setup-test
	scripts/elf-mutants
## measure the recovery from every fault, and write docs/reliability.md
reliability: setup-simavr firmware
	$(ON_CORE) cargo bench --profile dev --bench reliability
## measure the firmware in cycles of the AVR, and write docs/benchmarks.md: six minutes; then losses; then
## what "make bounds" proves, beside what the simulator observes
bench: setup-simavr firmware third-party
	$(if $(filter-out default,$(FEATURES)),NODE_ELF=$(ELF)) cargo bench --bench timing
	@$(SUB) losses
	@set -e; for board in "" "$(UNO)"; do scripts/boot $$board; done
	cargo bench --bench bounds
## count the frames lost on a full bus, ten minutes of each kind: hours
## (BOARD=uno; MINUTES=1; WHY=1; ONLY=position)
losses: setup-simavr
	@scripts/firmware $(SHIPPED)
	@scripts/firmware $(UNO) full
	$(ON_BOARD) $(ON_CORE) MINUTES='$(MINUTES)' WHY='$(WHY)' ONLY='$(ONLY)' cargo bench --bench loss
## measure how fast sim and the page run, and write it to docs/bench.md
speeds: setup-browser program-sim
	@scripts/web
	@scripts/speeds
## build every preset and feature, and write their sizes to docs/budget.md
budget: setup-build
	@scripts/budget-page
## write the tables and drawings of docs/wiring.md, from avr-specs
wiring:
	@scripts/wiring-page

# --- Tools

$(VENV)/installed: tests/clients/requirements.txt tests/clients/requirements-alone.txt | setup-bridge
	@echo "Installing pydronecan, pymavlink, MAVProxy and python-can into $(VENV): half a minute"
	python3 -m venv $(VENV)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check -r $<
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --no-deps -r tests/clients/requirements-alone.txt
	touch $@
$(VENV)/gui: tests/clients/requirements-gui.txt $(VENV)/installed
	@echo "Installing the DroneCAN GUI Tool, which only tests use, into $(VENV): 0.3 GB"
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --no-deps -r $<
	touch $@

VERSIONS := cargo-about@0.9.3 cargo-deny@0.20.2 cargo-fuzz@0.13.2 cargo-mutants@27.1.0 \
	cargo-semver-checks@0.51.0 ravedude@0.2.2
$(TOOLS)/bin/cargo-fuzz: | setup-fuzz
$(TOOLS)/bin/ravedude: | setup-flash
$(TOOLS)/bin/%: | setup-build
	@echo "Installing $*: $(if $(filter cargo-about cargo-semver-checks,$*),three minutes or more,half a \
		minute) on two cores"
	@CARGO_PROFILE_DEV_DEBUG=false cargo install --quiet --locked --root $(TOOLS) $(filter $*@%,$(VERSIONS)) \
		$(if $(filter cargo-about,$*),--features cli,--debug)
## remove what was built
clean:
	cargo clean
	rm -rf $(VENV) web/node_modules
