#!/usr/bin/env python3
"""Messages of further types in CDR, serialised by rosbags. Reference bytes for tesaki_recording."""

import numpy as np

from data_file import write
from mcap_joint_state import STORE

COLUMNS = """
Messages in CDR, in hexadecimal: geometry_msgs/msg/WrenchStamped, geometry_msgs/msg/PoseStamped,
diagnostic_msgs/msg/DiagnosticArray, visualization_msgs/msg/MarkerArray.
"""

START = 1_700_000_000_123_456_789


def make(name, *values):
    package, kind = name.split("/")
    return STORE.types[f"{package}/msg/{kind}"](*values)


def header(frame, time=START):
    return make("std_msgs/Header", make("builtin_interfaces/Time", time // 10**9, time % 10**9), frame)


def vector(x, y, z, kind="Vector3"):
    return make(f"geometry_msgs/{kind}", x, y, z)


def pose(position, quaternion):
    return make("geometry_msgs/Pose", vector(*position, "Point"), make("geometry_msgs/Quaternion", *quaternion))


def marker(frame, number, kind, action, place, scale, colour, points=()):
    return make(
        "visualization_msgs/Marker", header(frame), "tesaki", number, kind, action, place, vector(*scale),
        make("std_msgs/ColorRGBA", *colour), make("builtin_interfaces/Duration", 0, 0), True,
        [vector(*point, "Point") for point in points], [], "",
        make("sensor_msgs/CompressedImage", header("", 0), "", np.array([], np.uint8)), [], "", "",
        make("visualization_msgs/MeshFile", "", np.array([], np.uint8)), False,
    )


def encoded(name, *values):
    package, kind = name.split("/")
    kind = f"{package}/msg/{kind}"
    return bytes(STORE.serialize_cdr(STORE.types[kind](*values), kind, little_endian=True)).hex()


if __name__ == "__main__":
    wrench = make("geometry_msgs/Wrench", vector(1.0, -2.0, 0.5), vector(0.0, 0.25, -1e-3))
    status = [
        make("diagnostic_msgs/DiagnosticStatus", level, name, message, "hand3",
             [make("diagnostic_msgs/KeyValue", key, value) for key, value in values])
        for level, name, message, values in [
            (0, "tesaki: board", "disabled", [("supply [V]", "24.00"), ("節", "")]),
            (2, "tesaki: grasping", "", []),
        ]
    ]
    still = pose([0.0] * 3, [0.0, 0.0, 0.0, 1.0])
    place = pose([0.1, 0.2, -0.3], [0.0, 0.6, 0.0, 0.8])
    markers = [
        marker("", 0, 0, 3, still, [0.0] * 3, [0.0] * 4),
        marker("object", 1, 1, 0, place, [0.06, 0.05, 0.1], [1.0, 0.5, 0.25, 1.0]),
        marker("base", 2, 3, 0, place, [0.06, 0.06, 0.1], [0.0, 0.0, 0.0, 0.5]),
        marker("b", 3, 11, 0, still, [1.0] * 3, [1.0] * 4, [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, -2.0)]),
    ]
    messages = [
        encoded("geometry_msgs/WrenchStamped", header("finger1_tip"), wrench),
        encoded("geometry_msgs/PoseStamped", header("base"), place),
        encoded("diagnostic_msgs/DiagnosticArray", header(""), status),
        encoded("visualization_msgs/MarkerArray", markers),
    ]
    write("mcap_messages.in", __file__, COLUMNS, "&[\n" + "".join(f'    "{text}",\n' for text in messages) + "]\n")
