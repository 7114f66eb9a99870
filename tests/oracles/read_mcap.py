#!/usr/bin/env python3
"""Reads a recording with rosbags and prints one JSON object a topic: type, count, durability, first and last message
(by time; numbers that are not finite are strings).

Ends with an error unless every message decodes, all counts agree with the file's summary, and the definitions in
the file are those of ROS 2."""

import argparse
import dataclasses
import json
import math
import sys
from pathlib import Path

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


def main(path):
    topics, wrong, content = {}, [], path.read_bytes()
    with AnyReader([path]) as reader:
        for connection in reader.connections:
            kind = connection.msgtype
            digest = reader.typestore.hash_rihs01(kind)
            if digest != ROS.hash_rihs01(kind):
                wrong.append(f"{connection.topic}: the definition of {kind} is not that of ROS 2")
            if digest.encode() not in content:
                wrong.append(f"{connection.topic}: the hash of {kind} is wrong or missing")
            durability = [qos.durability.name.lower() for qos in connection.ext.offered_qos_profiles]
            topics[connection.topic] = {"topic": connection.topic, "type": kind, "count": 0, "durability": durability}
        for connection, time, data in reader.messages():
            topic = topics[connection.topic]
            topic["count"] += 1
            message = {"time": time, "message": plain(reader.deserialize(data, connection.msgtype))}
            topic.setdefault("first", message)
            topic["last"] = message
        for connection in reader.connections:
            if connection.msgcount != topics[connection.topic]["count"]:
                wrong.append(f"{connection.topic}: the summary counts {connection.msgcount} messages")
    for topic in topics.values():
        print(json.dumps(topic, ensure_ascii=False))
    if wrong:
        sys.exit("\n".join(wrong))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    main(parser.parse_args().file)
