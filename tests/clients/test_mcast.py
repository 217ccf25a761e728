"""pydronecan over UDP multicast, in a network namespace with the loopback interface and an Ethernet
like that of a computer: its address would be the source of datagrams to a route without `src`, and
Linux would drop them. Nothing leaves the namespace. The cases are in mcast_cases.py.
"""

import pathlib
import subprocess
import sys

import pytest

import mcast_cases
from conftest import namespace

CASES = pathlib.Path(mcast_cases.__file__)
ETHERNET = """
ip link set lo up
ip link add ethernet type veth peer name cable
ip addr add 192.0.2.7/24 dev ethernet
ip link set ethernet up
ip link set cable up
ip route add default via 192.0.2.1
"""
# As in docs/bench.md.
SETUP = f"{ETHERNET}ip route add 239.65.82.0/24 dev lo src 127.0.0.1"


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
