"""Frames of the wire protocol, made without any of its Rust: postcard and COBS by hand, CRC-32 from zlib.

Writes data/protocol_frames.in: a line `name: bytes` for each frame that docs/protocol.md shows.
"""
import pathlib
import struct
import zlib


def varint(value):
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def zigzag(value):
    return varint(value * 2 if value >= 0 else -value * 2 - 1)


def f32(*values):
    return b"".join(struct.pack("<f", value) for value in values)


def floats(*values):
    return varint(len(values)) + f32(*values)


def text(string):
    data = string.encode()
    return varint(len(data)) + data


def cobs(data):
    out, run = bytearray(), bytearray()
    for byte in data:
        if byte == 0:
            out += bytes([len(run) + 1]) + run
            run = bytearray()
        else:
            run.append(byte)
            if len(run) == 254:
                out += b"\xff" + run
                run = bytearray()
    return bytes(out + bytes([len(run) + 1]) + run)


def frame(message):
    return cobs(message + zlib.crc32(message).to_bytes(4, "little")) + b"\0"


CLIENT = 1


def request(sequence, kind, payload=b""):
    return varint(CLIENT) + varint(sequence) + varint(kind) + payload


def reply(sequence, tick, kind, payload=b""):
    return varint(0) + varint(CLIENT) + varint(sequence) + varint(tick) + varint(kind) + payload


NAN_FREE = [0.0, -0.25, 0.5]
FRAMES = {
    "hello": request(1, 0, varint(0x0123456789ABCDEF)),
    "take_command": request(2, 13, b"\x00"),
    "model_begin": request(3, 1, varint(1800) + varint(0xDEADBEEF)),
    "model_chunk": request(4, 2, varint(192) + varint(3) + bytes([7, 0, 9])),
    "model_commit": request(5, 3),
    "home": request(6, 4, floats(0.0, 0.5, -0.25)),
    "arm_pid": request(7, 5, varint(0) + varint(0)),
    "arm_observer": request(7, 5, varint(0) + varint(1)),
    "disarm": request(9, 6),
    "goal": request(10, 7, varint(0) + floats(0.1, 0.2, 0.3)),
    "stream": request(11, 7, varint(1) + varint(1) + f32(0.1, 0.5, -2.0)),
    "stop": request(12, 8),
    "read_status": request(13, 9),
    "read_faults": request(14, 10),
    "clear_faults": request(15, 11, varint(3)),
    "set_rate": request(16, 12, varint(0) + varint(5)),
    "release_command": request(17, 14),
    "export_model": request(18, 15, varint(0)),
    "export_state": request(18, 15, varint(1)),
    "read_export": request(19, 16, varint(192)),
    "reply_hello": reply(
        1, 0, 0,
        varint(0x0123456789ABCDEF) + bytes([0, 1, 0]) + bytes(range(1, 9)) + bytes(12) + varint(5),
    ),
    "reply_done": reply(2, 300, 1),
    "reply_refused_no_model": reply(7, 300, 2, varint(1)),
    "reply_refused_not_homed": reply(7, 300, 2, varint(7) + bytes([4])),
    "reply_refused_limits": reply(10, 300, 2, varint(11) + bytes([2]) + f32(9.0, -1.0, 1.0)),
    "reply_refused_commanded": reply(10, 300, 2, varint(16) + varint(0xCAFE)),
    "reply_refused_stale": reply(10, 300, 2, varint(18) + varint(11)),
    "reply_faults": reply(
        14, 1277, 4,
        varint(1) + varint(1) + varint(0) + b"\x00" + f32(0.11, 0.1) + varint(1277),
    ),
    "reply_exported": reply(18, 300, 5, varint(1500) + varint(0x12345678) + varint(4000)),
    "reply_chunk": reply(19, 300, 6, varint(192) + varint(2) + bytes([1, 2])),
    "telemetry": varint(1) + varint(300) + varint(1) + varint(0) + varint(1) + varint(0)
    + varint(2) + f32(0.1, 0.0, 0.1, 0.02) + f32(-0.2, 0.5, -0.19, -0.01),
    "log_sensors": varint(3) + varint(77) + varint(1) + varint(300) + b"\x00" + varint(24000)
    + varint(2) + zigzag(-5) + zigzag(65536) + varint(2) + zigzag(3) + zigzag(-400),
    "sensors": varint(300) + b"\x01" + varint(24000) + varint(2) + zigzag(-5) + zigzag(65536)
    + varint(2) + zigzag(3) + zigzag(-400),
    "actuators": varint(300) + b"\x01" + floats(*NAN_FREE),
}

if __name__ == "__main__":
    path = pathlib.Path(__file__).parent / "data" / "protocol_frames.in"
    lines = [f"{name}: {frame(message).hex(' ')}" for name, message in FRAMES.items()]
    path.write_text("\n".join(lines) + "\n")
