"""Recordings (MCAP with ROS 2 messages) as arrays.

Needs PyPI's ``mcap``: ``pip install tesaki[recordings]``.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from os import PathLike

import numpy as np

from ._tesaki import FileError

__all__ = ["Joints", "load"]


@dataclass(frozen=True)
class Joints:
    """Joints over time: n samples of k joints. Values that a recording does not contain are NaN."""

    names: list[str]
    """Names of the joints."""
    time: np.ndarray
    """(n,) [s], as the stamps of the messages."""
    position: np.ndarray
    """(n, k) [rad]."""
    velocity: np.ndarray
    """(n, k) [rad/s]."""
    effort: np.ndarray
    """(n, k) [N·m]."""


class _Unfit(ValueError):
    """The recording is sound, but not what was asked for."""


def load(path: str | PathLike[str], topic: str = "/joint_states") -> Joints:
    """Loads the joints from a recording of ``Board.record``, ``tesaki record`` or ``cargo sim run``.

    Args:
        path: the file.
        topic: ``/joint_states`` for what was measured, ``/tesaki/reference`` for the references.

    Raises:
        FileError: the file cannot be read, or is no MCAP file, such as the ``.log`` that is for ``tesaki replay``.
        ValueError: the recording has no such topic, or its joints change.
    """
    import mcap.reader

    try:
        return _load(path, topic, mcap.reader.make_reader)
    except OSError as error:
        raise FileError(f"{path}: {error.strerror or error}") from error
    except _Unfit:
        raise
    except Exception as error:  # of mcap, of the decompressors that it uses, or of a message that is cut
        raise FileError(f"{path} cannot be read as MCAP ({str(error) or 'it was cut'}); `tesaki record NAME` writes NAME.mcap") from error


def _load(path: str | PathLike[str], topic: str, make_reader) -> Joints:
    names: list[str] | None = None
    times, rows = [], []
    with open(path, "rb") as file:
        for schema, _, message in make_reader(file).iter_messages(topics=[topic]):
            if schema is None or schema.name != "sensor_msgs/msg/JointState":
                raise _Unfit(f"{path}: {topic} holds no joints but {schema.name if schema else 'nothing known'}")
            time, own, *columns = _joint_state(message.data)
            if names is not None and own != names:
                raise _Unfit(f"{path}: the joints of {topic} change at {time} s")
            names = own
            unknown = [np.nan] * len(own)
            times.append(time)
            rows.append([column if len(column) else unknown for column in columns])
    if names is None:
        raise _Unfit(f"{path} holds nothing on {topic}")
    table = np.array(rows, dtype=float).reshape(len(rows), 3, len(names))
    return Joints(names, np.array(times), table[:, 0], table[:, 1], table[:, 2])


def _joint_state(data: bytes):
    """Decodes time, names, position, velocity and effort of a JointState in little-endian CDR."""
    body = memoryview(data)[4:]
    place = 0

    def align(size):
        nonlocal place
        place += -place % size

    def number(form):
        nonlocal place
        size = struct.calcsize(form)
        align(size)
        (value,) = struct.unpack_from("<" + form, body, place)
        place += size
        return value

    def text():
        nonlocal place
        length = number("I")
        value = bytes(body[place : place + length - 1]).decode()
        place += length
        return value

    def numbers():
        nonlocal place
        count = number("I")
        if count:
            align(8)
        values = np.frombuffer(body, "<f8", count, place) if count else np.empty(0)
        place += 8 * count
        return values

    seconds, nanoseconds = number("i"), number("I")
    text()
    names = [text() for _ in range(number("I"))]
    return seconds + 1e-9 * nanoseconds, names, numbers(), numbers(), numbers()
