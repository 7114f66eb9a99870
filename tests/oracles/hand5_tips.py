#!/usr/bin/env python3
"""Makes hand5_tips.csv: fingertips of the five-finger hand, from which `tesaki retarget` must find joint angles that reproduce them:
Pinocchio's forward kinematics of robots/hand5/robot.urdf, mimic joints included, along a slow motion of the joints.
Time [s] and positions in the hand's frame [m].

    pip install numpy pin
    python3 tests/oracles/hand5_tips.py
    python3 tests/oracles/hand5_tips.py joints.csv     # largest deviation of the vectors of such a table [mm]
"""

import csv
import sys
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin

from data_file import DATA

HAND = Path(__file__).parent / "../../robots/hand5"
FINGERS = ["thumb", "index", "middle", "ring", "little"]
FRAMES, PERIOD = 40, 0.05


def load():
    """Returns the model with all joints free, what each mimic joint follows, and the names of the others."""
    path = HAND / "robot.urdf"
    model = pin.buildModelFromUrdf(str(path))
    mimics = {joint.get("name"): joint.find("mimic") for joint in ET.parse(path).getroot().findall("joint")}
    return model, mimics, [name for name in model.names[1:] if mimics[name] is None]


def tips(model, mimics, angles):
    data = model.createData()
    q = np.zeros(model.nq)
    for name in model.names[1:]:
        mimic = mimics[name]
        angle = angles[name] if mimic is None else float(mimic.get("multiplier")) * angles[mimic.get("joint")]
        q[model.joints[model.getJointId(name)].idx_q] = angle
    pin.framesForwardKinematics(model, data, q)
    return np.array([data.oMf[model.getFrameId(f"{finger}_tip")].translation for finger in FINGERS])


def motion(model, mimics, names):
    posture = {name: 0.0 for name in names} | tomllib.loads((HAND / "plant.toml").read_text())["posture"]
    for frame in range(FRAMES):
        phase = 2.0 * np.pi * frame / FRAMES
        bend = 0.25 * (1.0 - np.cos(phase))
        angles = {name: posture[name] + bend * (0.6 if name.endswith("bend") else 0.3) for name in names}
        angles["spread"] = 0.1 * np.sin(phase)
        angles["thumb_swing"] = 0.1 * np.sin(phase)
        yield frame * PERIOD, tips(model, mimics, angles)


def main():
    model, mimics, names = load()
    frames = list(motion(model, mimics, names))
    if len(sys.argv) > 1:
        with open(sys.argv[1], newline="") as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == len(frames)
        worst = 0.0
        for row, (_, expected) in zip(rows, frames):
            found = tips(model, mimics, {name: float(row[name]) for name in names})
            worst = max(worst, np.abs((found[1:] - found[0]) - (expected[1:] - expected[0])).max())
        print(f"{1e3 * worst:.4f} mm")
        return
    header = ",".join(["time"] + [f"{finger}_{axis}" for finger in FINGERS for axis in "xyz"])
    lines = [header] + [",".join(f"{x:.6f}" for x in [time, *expected.ravel()]) for time, expected in frames]
    (DATA / "hand5_tips.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
