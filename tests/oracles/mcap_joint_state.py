#!/usr/bin/env python3
"""Two JointState messages in CDR, serialised by rosbags. Reference bytes for tesaki_recording."""

import numpy as np
from rosbags.typesys import Stores, get_typestore

from data_file import write

COLUMNS = """
Messages of sensor_msgs/msg/JointState in CDR, in hexadecimal; positions [rad], velocities [rad/s],
efforts [N m].
"""

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPE = "sensor_msgs/msg/JointState"


def joint_state(time, names, position, velocity, effort):
    header = STORE.types["std_msgs/msg/Header"](
        stamp=STORE.types["builtin_interfaces/msg/Time"](sec=time // 10**9, nanosec=time % 10**9), frame_id=""
    )
    values = [np.array(v, dtype=np.float64) for v in (position, velocity, effort)]
    return bytes(STORE.serialize_cdr(STORE.types[TYPE](header, names, *values), TYPE, little_endian=True))


if __name__ == "__main__":
    messages = [
        joint_state(1_700_000_000_123_456_789, ["swing", "", "親指"], [0.1, -2.5, 3e-300], [], [1.0, -0.0, 1e9]),
        joint_state(1_700_000_001_000_000_001, ["thumb_curl"], [0.25], [-1.5], []),
    ]
    text = "&[\n" + "".join(f'    "{message.hex()}",\n' for message in messages) + "]\n"
    write("mcap_joint_state.in", __file__, COLUMNS, text)
