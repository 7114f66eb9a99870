#!/usr/bin/env python3
"""Reads a recording with rosbags and prints one JSON object a topic: type, count, durability, first and last message
(by time; numbers that are not finite are strings).

Ends with an error unless every message decodes, all counts agree with the file's summary and with what the package
mcap reads, the definitions in the file are those of ROS 2, and everything is so that the options ask for."""

import argparse
import dataclasses
import json
import math
import sys
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import mcap.reader
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

ROS = get_typestore(Stores.ROS2_JAZZY)


def plain(value):
    if dataclasses.is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value) if f.name != "__msgtype__"}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, list):
        return [plain(v) for v in value]
    return value


def read(path):
    """Returns what to print of each topic, all messages of each as (time, message), and the errors found."""
    topics, messages, wrong = {}, {}, []
    with path.open("rb") as file:
        # Without the index, which a killed recorder does not write.
        channels = [channel for _, channel, _ in mcap.reader.NonSeekingReader(file).iter_messages()]
    counts = Counter(channel.topic for channel in channels)
    hashes = {channel.topic: channel.metadata["topic_type_hash"] for channel in channels}
    with AnyReader([path]) as reader:
        for connection in reader.connections:
            kind = connection.msgtype
            digest = reader.typestore.hash_rihs01(kind)
            if digest != ROS.hash_rihs01(kind):
                wrong.append(f"{connection.topic}: the definition of {kind} is not that of ROS 2")
            if hashes.get(connection.topic) != digest:
                wrong.append(f"{connection.topic}: the hash of {kind} is wrong or missing")
            durability = [qos.durability.name.lower() for qos in connection.ext.offered_qos_profiles]
            topics[connection.topic] = {"topic": connection.topic, "type": kind, "count": 0, "durability": durability}
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append((time, message))
        for connection in reader.connections:
            topic, of_topic = topics[connection.topic], messages.get(connection.topic, [])
            topic["count"] = len(of_topic)
            if of_topic:
                ends = [{"time": time, "message": plain(message)} for time, message in (of_topic[0], of_topic[-1])]
                topic["first"], topic["last"] = ends
            if connection.msgcount != len(of_topic):
                wrong.append(f"{connection.topic}: the summary counts {connection.msgcount} messages")
    if counts != Counter({topic: len(of_topic) for topic, of_topic in messages.items()}):
        wrong.append(f"the package mcap finds other messages: {dict(counts)}")
    return topics, messages, wrong


def wrong_counts(messages, expected):
    for topic, count in expected:
        found = len(messages.get(topic, []))
        if found != int(count):
            yield f"{topic}: {found} messages, expected {count}"


def wrong_joints(messages, expected):
    last = messages["/joint_states"][-1][1]
    if expected and list(last.name) != [name for name, _ in expected]:
        yield f"/joint_states: the joints are {list(last.name)}"
        return
    for (name, angle), found in zip(expected, last.position):
        if not abs(found - float(angle)) <= 1e-6:
            yield f"/joint_states: {name} ends at {found}, expected {angle}"


def origin(joint):
    element = joint.find("origin")
    text = {} if element is None else element.attrib
    roll, pitch, yaw = map(float, text.get("rpy", "0 0 0").split())
    turn = about([0, 0, 1], yaw) @ about([0, 1, 0], pitch) @ about([1, 0, 0], roll)
    return np.array(text.get("xyz", "0 0 0").split(), float), turn


def about(axis, angle):
    """Returns rotation matrices about an axis, by Rodrigues' formula; one for each angle."""
    x, y, z = np.array(axis, float) / np.linalg.norm(axis)
    cross, angle = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.asarray(angle)[..., None, None]
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def matrices(quaternions):
    x, y, z, w = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def along(link, carrier, step):
    """Returns position and orientation of a link in the base frame, from the transforms between links."""
    if link not in carrier:
        return np.zeros(3), np.eye(3)
    position, turn = along(carrier[link], carrier, step)
    shift, own = step[link]
    return position + (turn @ shift[..., None])[..., 0], turn @ own


def wrong_frames(messages):
    """Compares each message on /tf, with /tf_static, with the URDF's chains at the joint angles of the same
    time."""
    robot = ET.fromstring(messages["/robot_description"][0][1].data)
    joints = {joint.find("child").get("link"): joint for joint in robot.findall("joint")}
    carrier = {link: joint.find("parent").get("link") for link, joint in joints.items()}
    states, frames = messages["/joint_states"], messages["/tf"]
    if [time for time, _ in states] != [time for time, _ in frames]:
        yield "/tf and /joint_states have different times"
        return
    fixed = {t.child_frame_id: t for _, message in messages["/tf_static"] for t in message.transforms}
    if any(joint.get("type") == "fixed" and link not in fixed for link, joint in joints.items()):
        yield "/tf_static lacks links that do not move"
        return
    found = [fixed | {t.child_frame_id: t for t in message.transforms} for _, message in frames]
    parents = [{link: t.header.frame_id for link, t in frame.items() if link in carrier} for frame in found]
    if any(parent != carrier for parent in parents):
        yield "/tf lacks links of the URDF, or hangs them elsewhere"
        return
    angles = {name: np.array([m.position[i] for _, m in states]) for i, name in enumerate(states[0][1].name)}
    by_urdf, by_tf = {}, {}
    for link, joint in joints.items():
        shift, turn = origin(joint)
        if joint.get("type") != "fixed":
            axis = [float(value) for value in joint.find("axis").get("xyz").split()]
            mimic = joint.find("mimic")
            if mimic is None:
                angle = angles[joint.get("name")]
            else:
                factor, offset = float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0))
                angle = factor * angles[mimic.get("joint")] + offset
            turn = turn @ about(axis, angle)
        by_urdf[link] = shift, turn
        poses = [frame[link].transform for frame in found]
        shifts = np.array([[p.translation.x, p.translation.y, p.translation.z] for p in poses])
        by_tf[link] = shifts, matrices(np.array([[p.rotation.x, p.rotation.y, p.rotation.z, p.rotation.w] for p in poses]))
    for link in joints:
        pairs = zip(along(link, carrier, by_urdf), along(link, carrier, by_tf))
        error = max(float(np.abs(a - b).max()) for a, b in pairs)
        if not error < 1e-9:
            yield f"/tf: {link} is off by {error:.2e}"
    print(f"/tf: {len(joints)} links in {len(frames)} messages are where the URDF has them", file=sys.stderr)


def pair(text):
    name, _, value = text.rpartition("=")
    return name, value


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--count", type=pair, action="append", default=[], metavar="TOPIC=N", help="so many messages")
    parser.add_argument("--joint", type=pair, action="append", default=[], metavar="NAME=ANGLE",
                        help="all joints in their order, and the angle at which each ends [rad], to 1e-6")
    parser.add_argument("--frames", action="store_true", help="/tf and /tf_static have all links where URDF and joint angles put them")
    options = parser.parse_args()
    topics, messages, wrong = read(options.file)
    for topic in topics.values():
        print(json.dumps(topic, ensure_ascii=False))
    wrong += wrong_counts(messages, options.count)
    wrong += wrong_joints(messages, options.joint) if options.joint else []
    wrong += wrong_frames(messages) if options.frames else []
    if wrong:
        sys.exit("\n".join(wrong))
