#!/usr/bin/env python3
"""Largest stiffness of a surface on which the sampled impedance loop of an arm is stable, from the eigenvalues of the loop
over a control period. Reference values for ImpedanceSettings::max_contact_stiffness.

The arm along the contact is a mass. The torques of a period give it the commanded acceleration a and balance the force
that was measured at its beginning, so that x'' = a - k (x - x_begin) / own. The law: a = M^-1 (F - B v - K x), held
("direct"), or the one after which the velocity is that of the impedance under a constant force.
"""

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from data_file import write

COLUMNS = """
Rows: whether the law is direct; mass [kg], damping [N s/m] and stiffness [N/m] of the impedance, own mass of the arm
[kg]; largest stiffness of the surface [N/m].
"""

T, MARGIN = 0.01, 1.3


def gains(direct, mass, damping, stiffness):
    """Returns the feedback of displacement, velocity and force."""
    if direct:
        return np.array([-stiffness, -damping, 1.0]) / mass
    target = expm(np.array([[0, 1, 0], [-stiffness / mass, -damping / mass, 1 / mass], [0, 0, 0]]) * T)
    return (target[1] - [0, 1, 0]) / T


def radius(surface, law, own):
    # States: displacement, velocity, displacement at the beginning of the period, commanded acceleration.
    motion = np.zeros((4, 4))
    motion[0, 1] = 1
    motion[1] = [-surface / own, 0, surface / own, 1]
    step = expm(motion * T)[:2]
    of_error, of_velocity, of_force = law
    begin = np.array([[1, 0], [0, 1], [1, 0], [of_error - of_force * surface, of_velocity]])
    return np.max(np.abs(np.linalg.eigvals(step @ begin)))


def limit(law, own):
    surfaces = np.geomspace(1.0, 0.9999 * own * (np.pi / T) ** 2, 4000)
    unstable = next((i for i, s in enumerate(surfaces) if radius(s, law, own) > 1), None)
    if unstable is None:
        return surfaces[-1]
    if unstable == 0:
        return 0.0
    return brentq(lambda s: radius(s, law, own) - 1, surfaces[unstable - 1], surfaces[unstable], xtol=1e-3)


if __name__ == "__main__":
    rows = []
    for own in (0.57, 3.4):
        for mass, damping, stiffness in ((1.0, 17.0, 300.0), (1.5, 7.5, 300.0), (1.5, 30.0, 300.0), (1.5, 110.0, 2000.0), (3.5, 60.0, 300.0), (6.0, 1.0, 300.0)):
            for direct in (True, False):
                law = gains(direct, mass, damping, stiffness)
                found = min(limit(law, own * MARGIN), limit(law, own / MARGIN))
                rows.append(f"    ({str(direct).lower()}, [{mass}, {damping}, {stiffness}, {own}], {float(found)!r}),")
    write("contact_stability.in", __file__, COLUMNS, "&[\n" + "\n".join(rows) + "\n]\n")
