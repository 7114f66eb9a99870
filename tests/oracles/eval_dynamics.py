#!/usr/bin/env python3
"""Torques, mass matrices and bias accelerations from Pinocchio's own URDF loader, to check `tesaki eval` with.

For each robot, in data/eval, of random motions within the limits:
- ROBOT_motions.csv: for each independent joint its angle, velocity, acceleration and rotor inertia; for each tip a
  wrench; gravity.
- ROBOT_rnea.csv: TIP.tau.JOINT for each tip and independent joint that moves it. A mimic joint's torque counts, by its
  factor, at the joint that it follows.
- ROBOT_mass.csv: TIP.JOINT.JOINT, likewise.
- ROBOT_bias.csv: TIP.ax .. TIP.alphaz, acceleration of the tip's origin and angular acceleration without joint
  acceleration, in axes of the base.

In these robots, only fixed parts are attached along the way to a tip. Other fingers are attached to the palm,
which does not move.
"""

import numpy as np
import pinocchio as pin
from eval_kinematics import OUT, ROBOTS, WORLD, Robot, number, table

NAMES = ["kinova_gen3", "ur5e", "ufactory_xarm7", "kinova_j2s6s200", "abb_irb140", "inspire_right"]
PARTS = ["fx", "fy", "fz", "mx", "my", "mz"]
BIAS = ["ax", "ay", "az", "alphax", "alphay", "alphaz"]


class Motion:
    """All joints of a robot in a random motion; mimic joints move with those that they follow."""

    def __init__(self, robot, rng):
        names = [joint.name for joint in robot.independent]
        small = len(names) * len(robot.tips) > 30  # a hand
        self.robot, self.model = robot, robot.plain
        self.angles = robot.random_angles(rng)
        self.velocities = {name: round(rng.uniform(-2, 2), 4) for name in names}
        self.accelerations = {name: round(rng.uniform(-10, 10), 4) for name in names}
        self.rotors = {name: round(rng.uniform(0, 1e-4 if small else 0.5), 7) for name in names}
        force, moment = (2, 0.05) if small else (50, 10)
        scales = [force] * 3 + [moment] * 3
        self.wrenches = {tip: [round(rng.uniform(-s, s), 4) for s in scales] for tip in robot.tips}
        gravity = rng.normal(size=3)
        self.gravity = [round(g, 4) for g in 9.81 * gravity / np.linalg.norm(gravity)]
        # Joints of the model that the independent ones move.
        self.joints = {joint.name: self.model.joints[self.model.getJointId(joint.name)].idx_v for joint in robot.joints
                       if joint.type in ("revolute", "continuous")}
        self.model.gravity.linear = np.array(self.gravity)
        armature = np.zeros(self.model.nv)
        for name, rotor in self.rotors.items():
            armature[self.joints[name]] = rotor
        self.model.armature = armature
        self.q = robot.configuration(self.model, self.angles)
        self.v, self.a = self.spread(self.velocities), self.spread(self.accelerations)

    def spread(self, values):
        vector, by_name = np.zeros(self.model.nv), self.robot.by_name
        for name, index in self.joints.items():
            source, factor, _ = self.robot.followed(by_name[name])
            vector[index] = factor * values[source]
        return vector

    def results(self, tip):
        """Returns torques and mass matrix of the independent joints, and the bias."""
        model, data, frame = self.model, self.model.createData(), self.model.getFrameId(tip)
        jacobian = pin.computeFrameJacobian(model, data, self.q, frame, WORLD).reshape(6, -1)
        torques = pin.rnea(model, data, self.q, self.v, self.a) - jacobian.T @ self.wrenches[tip]
        mass = pin.crba(model, data, self.q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        pin.forwardKinematics(model, data, self.q, self.v, 0 * self.v)
        bias = pin.getFrameClassicalAcceleration(model, data, frame, WORLD).vector
        drivers = self.robot.drivers(tip)
        moved = np.zeros((model.nv, len(drivers)))
        for joint in self.robot.tips[tip]:
            source, factor, _ = self.robot.followed(joint)
            moved[self.joints[joint.name], drivers.index(source)] = factor
        return moved.T @ torques, (moved.T @ mass @ moved).ravel(), bias


def make(name, seed):
    robot, rng = Robot(ROBOTS / f"{name}.urdf"), np.random.default_rng([24, seed])
    names, tips = [joint.name for joint in robot.independent], list(robot.tips)
    inputs, outputs = [], ([], [], [])
    for _ in range(10):
        motion = Motion(robot, rng)
        kinds = motion.angles, motion.velocities, motion.accelerations, motion.rotors
        row = [kind[name] for kind in kinds for name in names]
        row += [value for tip in tips for value in motion.wrenches[tip]] + motion.gravity
        inputs.append([repr(float(value)) for value in row])
        results = [motion.results(tip) for tip in tips]
        for output, parts in zip(outputs, zip(*results)):
            output.append([number(value) for part in parts for value in part])
    kinds = ["", ".velocity", ".acceleration", ".rotor_inertia"]
    header = [name + kind for kind in kinds for name in names] + [f"{t}.{part}" for t in tips for part in PARTS]
    table(OUT / f"{name}_motions.csv", header + ["gx", "gy", "gz"], inputs)
    drivers = robot.drivers
    table(OUT / f"{name}_rnea.csv", [f"{t}.tau.{j}" for t in tips for j in drivers(t)], outputs[0])
    header = [f"{t}.{row}.{column}" for t in tips for row in drivers(t) for column in drivers(t)]
    table(OUT / f"{name}_mass.csv", header, outputs[1])
    table(OUT / f"{name}_bias.csv", [f"{t}.{part}" for t in tips for part in BIAS], outputs[2])
    print(name, {tip: len(drivers(tip)) for tip in tips})


if __name__ == "__main__":
    for seed, name in enumerate(NAMES):
        make(name, seed)
