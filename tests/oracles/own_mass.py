#!/usr/bin/env python3
"""Own mass of robots/arm7 at its tool along x, y and z, 1 / (J M^-1 J^T)_ii, from Pinocchio. Reference values for
tesaki::task::impedance::own_mass."""

import tomllib
from pathlib import Path

import numpy as np
import pinocchio as pin

from data_file import write

COLUMNS = """
Rows: angles of the joints [rad]; own mass along x, y and z of the base [kg].
"""

ROBOT = Path(__file__).parent / "../../robots/arm7"
POSTURES = (
    [0, 0, 0, np.pi / 2, 0, 0, 0],
    [0.9, 0.3, -0.4, 1.2, 0.3, 0.4, -0.2],
    [0.3, 0.6, 0.8, 1.9, -0.9, -0.5, 0.6],
    [0.5, 0.2, 0.1, 2.2, 0, 0, 0],
)

if __name__ == "__main__":
    model = pin.buildModelFromUrdf(str(ROBOT / "robot.urdf"))
    settings = tomllib.loads((ROBOT / "controller.toml").read_text())
    default = settings["joint"]["motor"]["rotor_inertia"]
    own = settings["joints"]
    rotors = [own.get(name, {}).get("motor", {}).get("rotor_inertia", default) for name in list(model.names)[1:]]
    data, frame = model.createData(), model.getFrameId("hand")
    rows = []
    for posture in POSTURES:
        q = np.array(np.float32(posture), dtype=float)
        mass = pin.crba(model, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T + np.diag(rotors)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
        mobility = np.diag(jacobian @ np.linalg.solve(mass, jacobian.T))
        least = max(np.mean(mobility) / 5, 1e-6)
        values = [float(v) for v in 1 / np.maximum(mobility, least)]
        rows.append(f"    ({[float(v) for v in q]}, {values}),")
    write("own_mass.in", __file__, COLUMNS, "&[\n" + "\n".join(rows) + "\n]\n")
