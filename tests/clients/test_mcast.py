"""pydronecan over UDP multicast, in a network that has nothing but loopback: the cases are in mcast_cases.py."""

import functools
import os
import pathlib
import shutil
import subprocess
import sys

import pytest

import mcast_cases

CASES = pathlib.Path(mcast_cases.__file__)
# What the case starts dies with it.
UNSHARE = ["unshare", "--net", "--pid", "--fork", "--kill-child"]
# As docs/bench.md tells.
SCRIPT = 'ip link set lo up && ip route add 239.65.82.0/24 dev lo && exec "$@"'


@functools.cache
def namespace():
    """The start of a command line with a network of its own: as root, as the root of a user namespace, or by sudo."""
    back = ["setpriv", f"--reuid={os.getuid()}", f"--regid={os.getgid()}", "--clear-groups"]
    ways = [(UNSHARE, []), ([*UNSHARE, "--map-root-user"], []), (["sudo", "-n", "--preserve-env", *UNSHARE], back)]
    for way, user in ways:
        line = [*way, "sh", "-c", SCRIPT, "sh", *user]
        if shutil.which(way[0]) and subprocess.run([*line, "true"], capture_output=True).returncode == 0:
            return line
    pytest.fail("no network namespace to be had: be root, or let sudo work without a password")


@pytest.mark.timeout(150)
@pytest.mark.parametrize("case", [name for name in vars(mcast_cases) if name.startswith("test_")])
def test_over_multicast(case, tmp_path):
    line = [sys.executable, "-m", "pytest", "-q", f"--basetemp={tmp_path / 'inside'}", f"{CASES}::{case}"]
    done = subprocess.run([*namespace(), *line], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=120)
    assert done.returncode == 0 and "1 passed" in done.stdout, done.stdout
