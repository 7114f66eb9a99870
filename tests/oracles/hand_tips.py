#!/usr/bin/env python3
"""Makes allegro_tips.csv, leap_tips.csv and inspire_tips.csv: an operator's fingertips that these hands can
reproduce exactly, and the corresponding tips of the robot, by Pinocchio's forward kinematics along a slow
motion of the joints: the fingers move, then the thumb pinches with each finger in turn, down to the distance
at which the robot's tips touch.

The operator's vectors from the thumb are the robot's, shortened by `scale`; near contact, by the distance that
the retargeting adds (Hand5 section 2.3), which is inverted here by bisection. Time [s], positions [m] in the frame of
the hand; robot_ are the robot's in the frame of its base, relative to its thumb's.

    pip install numpy scipy pin
    python3 tests/oracles/hand_tips.py [NAME ...]
"""

import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from scipy.optimize import brentq, least_squares

from data_file import DATA

ROBOTS = Path(__file__).parent / "../../robots"
FINGERS = ["thumb", "index", "middle", "ring", "little"]
TIPS = {
    "allegro": ["link_15.0_tip", "link_3.0_tip", "link_7.0_tip", "link_11.0_tip"],
    "leap": ["thumb_tip", "index_tip", "middle_tip", "ring_tip"],
    "inspire": [f"R_{finger}_tip" for finger in ("thumb", "index", "middle", "ring", "pinky")],
}
PERIOD = 1 / 30
SECONDS = 3.0  # Duration of a motion there and back.
THUMB = np.array([0.04, 0.05, 0.07])  # The operator's thumb at the beginning.
SMALLEST = 1e-4  # Gap of the operator's tips in a pinch.


class Hand:
    def __init__(self, name):
        path = ROBOTS / name / "robot.urdf"
        self.model = pin.buildModelFromUrdf(str(path))
        self.data = self.model.createData()
        self.frames = [self.model.getFrameId(tip) for tip in TIPS[name]]
        self.settings = tomllib.loads((ROBOTS / name / "retargeting.toml").read_text())
        # From the operator's hand frame to the robot's base.
        self.turn = pin.rpy.rpyToMatrix(*self.settings["rotation"])
        # The angles of all joints are `couple` times those with a motor, plus `offset`: mimic joints follow.
        mimics = {
            joint.get("name"): joint.find("mimic")
            for joint in ElementTree.parse(path).getroot().iter("joint")
            if joint.find("mimic") is not None
        }
        names = list(self.model.names[1:])
        self.driven = [joint for joint in names if joint not in mimics]
        self.couple = np.array([[float(joint == other) for other in self.driven] for joint in names])
        self.offset = np.zeros(len(names))
        for joint, mimic in mimics.items():
            row = names.index(joint)
            self.couple[row, self.driven.index(mimic.get("joint"))] = float(mimic.get("multiplier", 1.0))
            self.offset[row] = float(mimic.get("offset", 0.0))
        own = [names.index(joint) for joint in self.driven]
        self.lower, self.upper = self.model.lowerPositionLimit[own], self.model.upperPositionLimit[own]
        self.open = np.array([self.settings["posture"][joint] for joint in self.driven])
        # Towards these limits, all joints bend the fingers further.
        bends = np.abs(self.upper) > np.abs(self.lower)
        self.closed = np.where(bends, self.upper, self.lower)

    def tips(self, q):
        pin.framesForwardKinematics(self.model, self.data, self.couple @ q + self.offset)
        return np.array([self.data.oMf[frame].translation for frame in self.frames])

    def pinch(self, finger):
        """Returns the posture nearest to the open one in which the tips of thumb and finger touch."""
        contact = self.settings["robot_contact"] + self.settings["scale"] * SMALLEST

        def residuals(q):
            tips = self.tips(q)
            distance = np.linalg.norm(tips[finger] - tips[0])
            return np.append(1e3 * (distance - contact), 1e-2 * (q - self.open))

        margin = 0.02
        q = least_squares(residuals, self.open, bounds=(self.lower + margin, self.upper - margin), xtol=1e-14).x
        return q

    def operator(self, vector):
        """Returns the operator's vector for one of the robot."""
        s = self.settings

        def robot(length):
            x = np.clip((s["far"] - max(length - s["operator_contact"], 0.0)) / (s["far"] - s["near"]), 0.0, 1.0)
            pinch = x * x * (3.0 - 2.0 * x)
            return s["scale"] * length + pinch * (s["robot_contact"] - s["scale"] * s["operator_contact"])

        length = np.linalg.norm(vector)
        assert length > robot(0.0), (length, robot(0.0))
        return vector / length * brentq(lambda x: robot(x) - length, 0.0, 1.0, xtol=1e-12)


def motion(hand):
    closings = [hand.open + 0.2 * (hand.closed - hand.open)] + [hand.pinch(f) for f in range(1, len(hand.frames))]
    frames = round(SECONDS / PERIOD)
    time = 0
    for closed in closings:
        for frame in range(frames):
            share = 0.5 * (1.0 - np.cos(2.0 * np.pi * frame / frames))
            q = hand.open + share * (closed - hand.open)
            yield time * PERIOD, np.clip(q, hand.lower, hand.upper)
            time += 1


def make(name):
    hand = Hand(name)
    fingers = FINGERS[: len(hand.frames)]
    header = ["time"] + [f"{who}{finger}_{axis}" for who in ("", "robot_") for finger in fingers for axis in "xyz"]
    lines, first, smallest = [",".join(header)], hand.tips(hand.open)[0], np.full(len(hand.frames), np.inf)
    for time, q in motion(hand):
        tips = hand.tips(q)
        thumb = THUMB + hand.turn.T @ (tips[0] - first) / hand.settings["scale"]
        vectors = tips - tips[0]
        operator = [thumb] + [thumb + hand.turn.T @ hand.operator(vector) for vector in vectors[1:]]
        smallest = np.minimum(smallest, np.linalg.norm(vectors, axis=1))
        lines.append(",".join(f"{x:.6f}" for x in [time, *np.ravel(operator), *np.ravel(vectors)]))
    print(name, "closest tips [mm]:", np.round(1e3 * smallest[1:], 3))
    (DATA / f"{name}_tips.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    for robot in sys.argv[1:] or TIPS:
        make(robot)
