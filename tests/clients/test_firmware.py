"""How `make firmware` and `make flash` react to FEATURES, BOARD, SHIELD and PORT."""

import glob
import os
import pty
import subprocess

import pytest

from conftest import ROOT, TARGET


def script(name, *arguments):
    """Runs a script without cargo, so that it cannot build."""
    line = [ROOT / "scripts" / name, *arguments]
    return subprocess.run(
        line,
        capture_output=True,
        text=True,
        env={"PATH": "/usr/bin:/bin", "CARGO_TARGET_DIR": str(TARGET)},
    )


def firmware(*arguments):
    return script("firmware", *arguments)


@pytest.mark.parametrize("wrong", ["lihgts", "allocation,lihgts", "thesis,lights", "none", "draft"])
def test_a_wrong_feature_is_answered_with_the_valid_ones(wrong):
    done = firmware("default", wrong)
    assert done.returncode == 1 and done.stdout == "" and done.stderr.count("\n") == 1, done
    presets, features = "default, full, remote, thesis", "allocation, any-rate, battery"
    assert f"one of {presets}, or a list of {features}" in done.stderr, done


@pytest.mark.parametrize(
    ("features", "name"),
    [
        ("", ""),
        ("default", ""),
        ("thesis", "-thesis"),
        ("stats, lights,button", "-button+lights+stats"),
    ],
)
def test_each_set_of_features_has_its_own_elf(features, name):
    assert firmware("--path", features).stdout == f"{TARGET}/firmware/diecimila-seeed{name}.elf\n"


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        (
            ["--board", "unu"],
            "BOARD=unu is wrong. Use one of diecimila, nano168, uno, nano, nano-new, duemilanove, "
            "promini.",
        ),
        (
            ["--shield", "seed"],
            "SHIELD=seed is wrong. Use one of seeed, seeed-v1.0, sparkfun, module, module-16mhz.",
        ),
        (["--cs", "D13"], "Use one of D5, D6, D7, D8, D9, D10, A1, A2, A3, A4, A5."),
        (["--int", "D4"], "use D2 or D3"),
        (["--crystal", "12"], "use 8 or 16"),
        (["--int", "D3", "button,lights"], "FEATURES=button"),
    ],
)
def test_a_wrong_board_or_pin_is_answered_with_the_valid_ones(wrong, right):
    done = firmware(*wrong)
    assert (
        done.returncode == 1
        and done.stdout == ""
        and right in done.stderr
        and done.stderr.count("\n") == 1
    ), done


@pytest.mark.parametrize(
    ("options", "name"),
    [
        (["--board", "uno", "--shield", "module"], "uno-module"),
        (["--board", "uno", "--shield", "module", "full"], "uno-module"),
        (["--board", "uno", "default"], "uno-seeed-default"),
        (
            [
                "--board",
                "nano",
                "--shield",
                "module",
                "--cs",
                "d8",
                "--int",
                "D3",
                "--crystal",
                "16MHz",
                "stats",
            ],
            "nano-module-csD8-intD3-16MHz-stats",
        ),
        (["--shield", "module", "--cs", "D10", "--crystal", "8"], "diecimila-module"),
    ],
)
def test_each_board_has_its_own_elf(options, name):
    assert firmware("--path", *options).stdout == f"{TARGET}/firmware/{name}.elf\n"


def test_the_drawings_match_the_table_of_boards():
    done = script("wiring-page", "--check")
    assert done.returncode == 0, done.stderr


def test_flash_checks_the_port_before_anything_else():
    for port, answer in [
        ("/dev/no-such", "PORT=/dev/no-such does not exist."),
        (__file__, "is no serial port."),
        ("/dev/null", "is no serial port."),
    ]:
        done = subprocess.run(
            ["make", "flash", f"PORT={port}"], cwd=ROOT, capture_output=True, text=True, timeout=30
        )
        assert done.returncode == 2 and answer in done.stderr and "machine" in done.stderr, done
    # A terminal is accepted as a port; the board's name is wrong.
    keyboard, port = pty.openpty()
    done = script("flash", "--check", "--port", os.ttyname(port))
    assert done.returncode == 0, done
    assert "CS on D9, INT on D2, crystal 16 MHz" in done.stdout and "SHIELD=" in done.stdout, done
    done = script("flash", "--check", "--port", os.ttyname(port), "--shield", "module")
    assert "CS on D10, INT on D2, crystal 8 MHz" in done.stdout, done
    assert "bus 500 kbit/s, servo on D9" in done.stdout and "SHIELD=" not in done.stdout, done
    done = script("flash", "--check", "--port", os.ttyname(port), "--board", "unu")
    assert done.returncode == 1 and "BOARD=unu" in done.stderr, done
    os.close(keyboard)
    os.close(port)


@pytest.mark.skipif(bool(glob.glob("/dev/tty[UA][SC][BM]*")), reason="the machine has a port")
def test_flash_without_a_port_answers_with_the_words_that_it_was_given():
    words = ["BOARD=nano", "SHIELD=module", "FEATURES=stats"]
    done = subprocess.run(
        ["make", "flash", *words], cwd=ROOT, capture_output=True, text=True, timeout=30
    )
    assert done.returncode == 2, done
    assert "make flash BOARD=nano SHIELD=module FEATURES=stats PORT=/dev/" in done.stderr, done
    # Also which wiring that is.
    assert "CS on D10, INT on D2, crystal 8 MHz" in done.stdout, done


def test_a_misspelt_word_of_make_is_answered_with_the_right_ones():
    """Make itself would ignore it, and build for the default CAN board."""
    for line, wrong in [
        (["flash", "BOARD=nano", "SHEILD=module"], "SHEILD= is wrong"),
        (["firmware", "feature=stats"], "feature= is wrong"),
    ]:
        done = subprocess.run(["make", *line], cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 2 and wrong in done.stderr and " SHIELD " in done.stderr, done


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (["bootloader"], "Say which programmer: make bootloader PROGRAMMER=usbasp"),
        (["bootloader", "PROGRAMMER=usbasp", "STOCK=no-such.hex"], "no-such.hex does not exist"),
        (["bootloader", "PROGRAMMER=usbasp", "BOARD=unu"], "BOARD=unu is wrong. Use one of"),
        (["bootloader", "PROGRAMMER=usbsap"], "usbsap: avrdude knows no programmer of this name"),
        (["bootloader", "BOARD=uno"], "Say which programmer: make bootloader BOARD=uno PROG"),
        (["update"], "Say which bus: make update NODE=120 BUS=slcan:/dev/ttyACM0"),
        (["update", "BOARD=uno"], "Say which bus: make update BOARD=uno NODE=120 BUS="),
        (["bootloader", "PROGRAMMER=usbasp", "STOCK=README.md"], "README.md is no HEX file"),
        (["flash", "FEATURES=feature"], "FEATURES=feature: 'feature' is wrong. Use one of"),
        (["flash", "BOARD=nano", "INT=D3"], "INT on D3 takes the light's pin"),
        (["update", "BUS=mcast:0"], "Say which node: make update NODE=120 BUS=mcast:0"),
        (["update", "BUS=mcast:0", "NODE=1", "FILE=no-such.bin"], "FILE=no-such.bin is no file"),
    ],
)
def test_make_asks_for_what_is_missing_before_it_builds(line, answer):
    done = subprocess.run(["make", *line], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2 and answer in done.stderr and "ompiling" not in done.stdout, done


def test_the_archive_of_a_release_has_wiring_bit_rate_and_fuses():
    done = script("dist", "--readme", "--board", "nano", "--shield", "module")
    page = done.stdout
    for line in [
        "CS on D10, INT on D2, crystal 8 MHz, bus 500 kbit/s, servo on D9, outputs 2 to 8 on D5 ",
        "avrdude -c arduino -p atmega328p -b 57600 -D -P /dev/ttyUSB0 -U flash:w:nano-module.hex:i",
        "avrdude -c usbasp -p atmega328p -e -U lock:w:0x3F:m -U lfuse:w:0xFF:m -U hfuse:w:0xDA:m",
        "-U flash:w:boot-nano-module.hex:i -U lock:w:0xEF:m",
    ]:
        assert line in page, done
    every = script("dist", "--readme").stdout
    assert "* `diecimila-seeed`: " in every and "* `promini-module-16mhz`: " in every, every


# cargo waits while other parts of "make test" compile.
@pytest.mark.timeout(600)
def test_cargo_run_prints_how_to_flash_and_how_to_simulate():
    done = subprocess.run(["cargo", "run", "--quiet"], cwd=ROOT, capture_output=True, text=True)
    last = done.stderr.splitlines()[-1]
    assert "make flash" in last and "make sim" in last, done
