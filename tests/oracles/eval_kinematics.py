#!/usr/bin/env python3
"""Tip poses and Jacobians of whole robots from Pinocchio's own URDF loader, as tables to check `tesaki eval` with.

For each robot, in data/eval:
- ROBOT_states.csv: angles [rad] of the independent (non-mimic) revolute and continuous joints, in the file's order.
  Random, within the limits, those of the mimic joints included.
- ROBOT_fk.csv: for each tip its position [m] and orientation (quaternion, w not negative) in the base's frame, columns
  TIP.x .. TIP.qw.
- ROBOT_jacobian.csv: for each tip, row and independent joint that moves it a column TIP.ROW.JOINT. Rows vx vy vz wx wy
  wz: linear velocity of the tip, angular velocity, base axes, per rad/s of the joint. A mimic joint
  contributes to the column of the joint that it follows.

A tip is a leaf link with a moving joint before it and no prismatic one. Prismatic joints stay at zero. Names may
contain dots; tips are in the order of their links in the file, joints in the order of the joints.
"""

import csv
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
from kinematics import HERE, ROBOTS, joints_of, quaternion

OUT = Path(HERE) / "data/eval"
NAMES = ["kinova_gen3", "franka_panda", "allegro_right", "inspire_right", "robotiq_2f85"]
TURNING = ("revolute", "continuous")
ROWS = ["vx", "vy", "vz", "wx", "wy", "wz"]
WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class Robot:
    def __init__(self, path):
        self.joints = joints_of(path)
        self.by_name = {joint.name: joint for joint in self.joints}
        self.independent = [j for j in self.joints if j.type in TURNING and j.mimic is None]
        to_link = {joint.child: joint for joint in self.joints}
        self.tips = {}
        for link in (element.get("name") for element in ET.parse(path).getroot().findall("link")):
            if any(joint.parent == link for joint in self.joints):
                continue
            way, at = [], link
            while at in to_link:
                way.append(to_link[at])
                at = way[-1].parent
            moving = [joint for joint in way if joint.type != "fixed"]
            if moving and all(joint.type in TURNING for joint in moving):
                self.tips[link] = moving
        self.plain = pin.buildModelFromUrdf(str(path))
        self.mimicking = pin.buildModelFromUrdf(str(path), mimic=True)

    def followed(self, joint):
        """Returns the independent joint that determines a joint, the factor and the offset."""
        if joint.mimic is None:
            return joint.name, 1.0, 0.0
        name, factor, offset = joint.mimic
        source, further, shift = self.followed(self.by_name[name])
        return source, factor * further, offset + factor * shift

    def angle(self, joint, angles):
        source, factor, offset = self.followed(joint)
        return factor * angles[source] + offset

    def random_angles(self, rng):
        turning = [joint for joint in self.joints if joint.type in TURNING]
        while True:
            angles = {j.name: round(rng.uniform(j.lower, j.upper), 6) for j in self.independent}
            if all(j.lower <= self.angle(j, angles) <= j.upper for j in turning):
                return angles

    def configuration(self, model, angles):
        q = pin.neutral(model)
        for joint in self.joints:
            if joint.type not in TURNING or (model is self.mimicking and joint.mimic is not None):
                continue
            angle, state = self.angle(joint, angles), model.joints[model.getJointId(joint.name)]
            q[state.idx_q : state.idx_q + state.nq] = [np.cos(angle), np.sin(angle)] if state.nq == 2 else angle
        return q

    def drivers(self, tip):
        sources = {self.followed(joint)[0] for joint in self.tips[tip]}
        return [joint.name for joint in self.independent if joint.name in sources]

    def evaluate(self, tip, angles):
        """Returns the pose of the tip and the Jacobian by joint; once with mimic joints by hand, once with
        Pinocchio's own."""
        columns, places = [], []
        for model in (self.plain, self.mimicking):
            data, frame, q = model.createData(), model.getFrameId(tip), self.configuration(model, angles)
            # Pinocchio returns a single column as a plain vector.
            j = pin.computeFrameJacobian(model, data, q, frame, WORLD).reshape(6, -1)
            pin.framesForwardKinematics(model, data, q)
            places.append(data.oMf[frame].copy())
            by_joint = {name: np.zeros(6) for name in self.drivers(tip)}
            for joint in self.tips[tip]:
                if model is self.mimicking and joint.mimic is not None:
                    continue
                source, factor, _ = self.followed(joint)
                by_joint[source] += factor * j[:, model.joints[model.getJointId(joint.name)].idx_v]
            if model is self.mimicking:
                # A joint that moves the tip only through mimic joints is not on the tip's path to the base.
                for name in by_joint:
                    by_joint[name] = j[:, model.joints[model.getJointId(name)].idx_v]
            columns.append(by_joint)
        assert np.abs(places[0].homogeneous - places[1].homogeneous).max() < 1e-12
        for name in columns[0]:
            assert np.abs(columns[0][name] - columns[1][name]).max() < 1e-12, (tip, name)
        return places[0], columns[0]


def table(path, header, rows):
    assert all(len(row) == len(header) for row in rows)
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


def number(value):
    return repr(round(float(value), 12) + 0.0)


def make(name, seed):
    robot, rng = Robot(ROBOTS / f"{name}.urdf"), np.random.default_rng([22, seed])
    states, poses, jacobians = [], [], []
    while len(states) < 10:
        angles = robot.random_angles(rng)
        results = {tip: robot.evaluate(tip, angles) for tip in robot.tips}
        quaternions = {tip: quaternion(place.rotation) for tip, (place, _) in results.items()}
        if min(q[3] for q in quaternions.values()) < 0.01:
            continue  # its sign would hang on the last bit
        states.append([repr(angle) for angle in angles.values()])
        poses.append([])
        jacobians.append([])
        for tip, (place, columns) in results.items():
            poses[-1] += [number(v) for v in (*place.translation, *quaternions[tip])]
            jacobians[-1] += [number(column[row]) for row in range(6) for column in columns.values()]
    table(OUT / f"{name}_states.csv", [joint.name for joint in robot.independent], states)
    table(OUT / f"{name}_fk.csv", [f"{t}.{c}" for t in robot.tips for c in "x y z qx qy qz qw".split()], poses)
    header = [f"{t}.{row}.{joint}" for t in robot.tips for row in ROWS for joint in robot.drivers(t)]
    table(OUT / f"{name}_jacobian.csv", header, jacobians)
    print(name, {tip: len(robot.drivers(tip)) for tip in robot.tips})


if __name__ == "__main__":
    OUT.mkdir(exist_ok=True)
    for seed, name in enumerate(NAMES):
        make(name, seed)
