#!/usr/bin/env python3
"""The load of the motor that spreads the fingers of robots/hand5: its own finger and three that follow it by
<mimic>. Mass matrix M and gravity of all joints by Pinocchio, which takes them as independent here; T takes
the velocities of the joints with a motor to those of all: Tᵀ M T with the rotors, over all combinations of
the limits."""

import itertools
from pathlib import Path

import numpy as np
import pinocchio as pin

from data_file import write

COLUMNS = """
The joint `spread` of robots/hand5, upright: inertia with the other joints held, and free [kg m²], torque of gravity [N m];
of all combinations of the joints' limits the largest, the smallest, the largest. With the rotors of `tesaki model init`.
"""
FOLLOWERS = {"middle_spread": 0.3, "ring_spread": -0.4, "little_spread": -1.0}
# Rotors by torque [N m]: of maxon-16mm, xl330-m288, and of the generic motor for 0.8 N m [kg m²].
ROTORS = {0.6: 0.0014, 0.5: 0.00096, 0.4: 0.00096, 0.8: 0.004}


def main():
    model = pin.buildModelFromUrdf(str(Path(__file__).parent / "../../robots/hand5/robot.urdf"))
    data = model.createData()
    index = {name: model.joints[model.getJointId(name)].idx_v for name in list(model.names)[1:]}
    motors = [name for name in index if name not in FOLLOWERS and not name.startswith("thumb")]
    spread = motors.index("spread")
    transform = np.zeros((model.nv, len(motors)))
    for column, name in enumerate(motors):
        transform[index[name], column] = 1
    for name, ratio in FOLLOWERS.items():
        transform[index[name], spread] = ratio
    rotors = np.diag([ROTORS[round(float(model.effortLimit[index[name]]), 3)] for name in motors])
    limits = [(model.lowerPositionLimit[index[name]], model.upperPositionLimit[index[name]]) for name in motors]
    held, free, gravity = 0.0, np.inf, 0.0
    for posture in itertools.product(*limits):
        q = transform @ np.array(posture)
        mass = np.triu(pin.crba(model, data, q))
        mass += np.triu(mass, 1).T
        mass = transform.T @ mass @ transform + rotors
        held = max(held, mass[spread, spread])
        free = min(free, 1 / np.linalg.inv(mass)[spread, spread])
        gravity = max(gravity, abs(transform.T @ pin.computeGeneralizedGravity(model, data, q))[spread])
    write("hand5_spread.in", __file__, COLUMNS, f"[{held:.9f}, {free:.9f}, {gravity:.9f}]\n")


if __name__ == "__main__":
    main()
