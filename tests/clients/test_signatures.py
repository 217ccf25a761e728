"""The signatures that crates/dronecan-wire computes from definitions in DSDL are pydronecan's."""

import os
import re
import subprocess

import dronecan
from dronecan.dsdl.parser import CompoundType

from conftest import ROOT

# "make test-programs" builds the example.
TARGET = ROOT / os.environ.get("CARGO_TARGET_DIR", "target")


def fields(kind):
    if kind.kind == CompoundType.KIND_SERVICE:
        return kind.request_fields + kind.response_fields
    return kind.fields


def test_each_type_of_pydronecan_has_its_signature_and_seed():
    assert len(dronecan.TYPENAMES) > 140
    for name, kind in dronecan.TYPENAMES.items():
        nested = [field.type.get_data_type_signature() for field in fields(kind)]
        nested = [f"{signature:#x}" for signature in nested if signature is not None]
        output = subprocess.run(
            [TARGET / "debug/examples/signature", name, *nested],
            input=kind.source_text,
            capture_output=True,
            text=True,
        )
        signature = kind.get_data_type_signature()
        assert output.stdout.startswith(f"{name} 0x{signature:016X} "), output


def test_the_standard_types_of_the_crate_have_these_signatures():
    text = (ROOT / "crates/dronecan-wire/src/types.rs").read_text()
    rows = re.findall(r"= \d+, 0x([0-9A-F_]+),\s+\"([\w.]+)\";", text)
    assert len(rows) > 90
    for signature, name in rows:
        kind = dronecan.TYPENAMES[name]
        assert int(signature, 16) == kind.get_data_type_signature(), name
