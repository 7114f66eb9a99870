"""postcard and COBS by hand, and zlib's CRC-32: what the golden frames of `protocol.py` are made with."""

import struct
import zlib

# ---- postcard ----------------------------------------------------------------------------------------------


def uint(value):
    """u16, u32, u64, lengths and numbers of variants: seven bits per byte, the lowest first."""
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)


def sint(value):
    """i16, i32: zigzag, then like the unsigned ones."""
    return uint(2 * value if value >= 0 else -2 * value - 1)


def byte(value):
    return bytes([value])


boolean = byte


def real(value):
    return struct.pack("<f", value)


def reals(values):
    """A fixed array: no length."""
    return b"".join(real(value) for value in values)


def sequence(items):
    items = list(items)
    return uint(len(items)) + b"".join(items)


def blob(data):
    return uint(len(data)) + bytes(data)


def text(string):
    return blob(string.encode())


def option(value):
    return b"\0" if value is None else b"\1" + value


def key(value):
    """A fixed array of bytes, written in hexadecimal."""
    return bytes.fromhex(value)


# ---- frames ------------------------------------------------------------------------------------------------


def cobs(data):
    out = b""
    runs = data.split(b"\0")
    for run in runs:
        while len(run) >= 254:  # a full group stands for no zero
            out, run = out + b"\xff" + run[:254], run[254:]
        out += bytes([len(run) + 1]) + run
    # A full group at the end is not followed by another one.
    return out[:-1] if runs[-1] and len(runs[-1]) % 254 == 0 else out


def frame(message):
    return cobs(message + zlib.crc32(message).to_bytes(4, "little")) + b"\0"


assert cobs(b"") == b"\1" and cobs(b"\0") == b"\1\1" and cobs(b"\x0b\0\x16") == b"\2\x0b\2\x16"
assert cobs(bytes(range(1, 255))) == b"\xff" + bytes(range(1, 255))
assert cobs(b"\0" + bytes(range(1, 255))) == b"\1\xff" + bytes(range(1, 255))
assert cobs(b"\1" * 255) == b"\xff" + b"\1" * 254 + b"\2\1"
