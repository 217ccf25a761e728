"""What `make firmware` says to FEATURES."""

import subprocess

import pytest

from conftest import ROOT, TARGET


def firmware(*arguments):
    """Nothing can be built: there is no cargo."""
    line = [ROOT / "scripts/firmware", *arguments]
    return subprocess.run(line, capture_output=True, text=True, env={"PATH": "/usr/bin:/bin", "CARGO_TARGET_DIR": str(TARGET)})


@pytest.mark.parametrize("wrong", ["lihgts", "allocation,lihgts", "thesis,lights"])
def test_a_wrong_name_is_answered_with_the_right_ones(wrong):
    done = firmware("default", wrong)
    assert done.returncode == 1 and done.stdout == "" and done.stderr.count("\n") == 1, done
    assert "default, full, thesis, none" in done.stderr and "allocation, button" in done.stderr, done


@pytest.mark.parametrize(
    ("features", "name"),
    [
        ("", ""),
        ("default", ""),
        ("none", "-none"),
        ("thesis", "-thesis"),
        ("stats, lights,button", "-button+lights+stats"),
    ],
)
def test_each_set_of_features_has_an_elf_of_its_own(features, name):
    assert firmware("--path", features).stdout == f"{TARGET}/firmware/diecimila-seeed{name}.elf\n"
