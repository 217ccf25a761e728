"""A second implementation of the UAVCAN draft of 2014: frames by its layouts; payloads and
signatures by pydronecan from its definitions.

    identifier: type[28:19] transfer type[18:17] source[16:10] frame index[9:4] last[3]
                transfer ID[2:0]

A frame of a message to all has eight bytes of payload; every other begins with its destination.
What is longer than one frame begins with its CRC, little endian.

The field lists are those of libuavcan at 3b3c0d3b (2015-03-19), but for Command, which is the one
before it had a unit. Their order, names and types are what a signature is made of.
"""

import pathlib
import tempfile

from dronecan import dsdl, transport
from dronecan.dsdl.common import bytes_from_crc64, crc16_from_bytes

RESPONSE, REQUEST, BROADCAST, UNICAST = range(4)

VERSION = ["uint8 major", "uint8 minor"]
# The definitions without comments and constants, which do not affect a signature.
DEFINITIONS = {
    "protocol/NodeStatus": [
        "uint28 uptime_sec",
        "uint4 status_code",
        "uint16 vendor_specific_status_code",
    ],
    "protocol/SoftwareVersion": [
        *VERSION,
        "uint8 optional_field_mask",
        "uint32 vcs_commit",
        "uint64 image_crc",
    ],
    "protocol/HardwareVersion": [
        *VERSION,
        "uint8[16] unique_id",
        "uint8[<=255] certificate_of_authenticity",
    ],
    "protocol/GetNodeInfo": [
        "---",
        "NodeStatus status",
        "SoftwareVersion software_version",
        "HardwareVersion hardware_version",
        "uint8[<=80] name",
    ],
    "protocol/RestartNode": ["uint40 magic_number", "---", "bool ok"],
    "protocol/param/ValueString": ["uint8[<=63] value"],
    "protocol/param/Value": [
        "bool[<=1] value_bool",
        "int64[<=1] value_int",
        "float32[<=1] value_float",
        "ValueString[<=1] value_string",
    ],
    "protocol/param/GetSet": [
        "Value value",
        "uint8 index",
        "uint8[<=92] name",
        "---",
        "Value value",
        "Value default_value",
        "Value max_value",
        "Value min_value",
        "uint8[<=92] name",
    ],
    "equipment/actuator/Command": ["uint8 actuator_id", "float16 command"],
    "equipment/actuator/ArrayCommand": ["Command[<32] commands"],
    "equipment/actuator/Status": [
        "uint8 actuator_id",
        "float16 position",
        "float16 force",
        "float16 speed",
        "uint7 power_rating_pct",
    ],
}


def _types():
    """All types by their short names. pydronecan no longer allows the IDs of that time, so the
    files have none.
    """
    with tempfile.TemporaryDirectory() as directory:
        root = pathlib.Path(directory) / "uavcan"
        for name, fields in DEFINITIONS.items():
            path = root / f"{name}.uavcan"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("\n".join(fields) + "\n")
        return {
            found.full_name.rsplit(".", 1)[1]: found
            for found in dsdl.parse_namespaces([str(root)], [])
        }


TYPES = _types()


def signature(name):
    return TYPES[name].get_data_type_signature()


def new(name, mode=None, **fields):
    """A value of one of the types; `mode` is "request" or "response" of a service."""
    return transport.CompoundValue(TYPES[name], mode, **fields)


def pack(value):
    return transport.bytes_from_bits(value._pack())


def unpack(name, data, mode=None):
    value = new(name, mode)
    value._unpack(transport.bits_from_bytes(data))
    return value


def identifier(type_id, transfer_type, source, transfer_id, index=0, last=True):
    return type_id << 19 | transfer_type << 17 | source << 10 | index << 4 | last << 3 | transfer_id


def fields(can_id):
    """Returns type, transfer type, source, transfer ID, frame index, and whether this is the last
    frame.
    """
    return (
        can_id >> 19,
        can_id >> 17 & 3,
        can_id >> 10 & 0x7F,
        can_id & 7,
        can_id >> 4 & 0x3F,
        can_id >> 3 & 1,
    )


def frames(type_id, transfer_type, source, transfer_id, payload, destination=None, name=None):
    """Returns (identifier, data) of each frame. A long payload needs its type's `name`, for the
    CRC.
    """
    front = [] if transfer_type == BROADCAST else [destination]
    room = 8 - len(front)
    stream = bytes(payload)
    if len(stream) > room:
        crc = crc16_from_bytes(bytes_from_crc64(signature(name)))
        stream = crc16_from_bytes(stream, initial=crc).to_bytes(2, "little") + stream
    parts = [stream[at : at + room] for at in range(0, len(stream), room)] or [b""]
    return [
        (
            identifier(type_id, transfer_type, source, transfer_id, index, index == len(parts) - 1),
            bytes(front) + part,
        )
        for index, part in enumerate(parts)
    ]
