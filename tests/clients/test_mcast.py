"""pydronecan over UDP multicast, in a network namespace that has only the loopback interface. The
cases are in mcast_cases.py.
"""

import pathlib
import subprocess
import sys

import pytest

import mcast_cases
from conftest import namespace

CASES = pathlib.Path(mcast_cases.__file__)
# As in docs/bench.md.
SETUP = "ip link set lo up\nip route add 239.65.82.0/24 dev lo"


@pytest.mark.timeout(150)
@pytest.mark.parametrize("case", [name for name in vars(mcast_cases) if name.startswith("test_")])
def test_over_multicast(case, tmp_path):
    line = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        f"--basetemp={tmp_path / 'inside'}",
        f"{CASES}::{case}",
    ]
    done = subprocess.run(
        [*namespace(SETUP), *line],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0 and "1 passed" in done.stdout, done.stdout
