#!/usr/bin/env python3
"""Reference responses for tesaki::control::CurrentLoop, by SciPy: the winding sampled by a zero-order hold, the
controller as a transfer function, and a period of delay, in a loop."""

import numpy as np
from scipy import signal

from data_file import write

COLUMNS = """
Steps of the current of three motors, whose windings deviate from what the loop was given; 40 kHz.
maxon RE 25, 118752 (coreless): terminal resistance, inductance and torque constant of maxon's catalogue.
Pololu micro metal gearmotor HP 6 V, 30:1 (N20, iron core): resistance from the stall current, back-EMF from the speed
without load of Pololu's table; its inductance is not published, 1 mH is assumed.
Quanser SRV02 (Faulhaber 2338S006 with a gear of 70): Table 3.1 of the SRV02 user manual.
Rows: motor, [resistance [Ohm], inductance [H], back-EMF at the output [V s/rad]], supply [V], a list of
(factor of the resistance, factor of the inductance, a, (1 - a)/R [1/Ohm], current of each period per step).
"""

T, GAIN = 25e-6, 0.18
MOTORS = [
    ("maxon RE 25", 2.32, 0.24e-3, 0.0234, 24.0),
    # 1.5 A at 6 V; 1000 rpm.
    ("Pololu N20 HP", 6 / 1.5, 1e-3, 6 / (1000 * 2 * np.pi / 60), 6.0),
    ("Quanser SRV02", 2.6, 0.18e-3, 70 * 7.68e-3, 6.0),
]


def sampled(resistance, inductance):
    """Returns the sampled winding 1/(L s + R): numerator and denominator in z."""
    num, den, _ = signal.cont2discrete(([1.0], [inductance, resistance]), T, method="zoh")
    return num.ravel(), den


def response(resistance, inductance, real):
    pole = -sampled(resistance, inductance)[1][1]
    gain = GAIN * resistance / (1 - pole)
    num, den = sampled(*real)
    num = np.polymul(num[np.flatnonzero(num)[0]:], [gain, -gain * pole])
    den = np.polymul(np.polymul(den, [1, -1]), [1, 0])
    _, (step,) = signal.dstep((num, np.polyadd(den, num), T), n=200)
    return step.ravel()


def main():
    rows = []
    for name, r, l, emf, supply in MOTORS:
        deviations = []
        for fr in (1.0, 0.8, 1.2):
            for fl in (1.0, 0.8, 1.2):
                num, den = sampled(r * fr, l * fl)
                steps = ", ".join(f"{value:.6f}" for value in response(r, l, (r * fr, l * fl)))
                deviations.append(f"        ({fr}, {fl}, {-den[1]:.9f}, {num[-1]:.9f}, &[{steps}]),")
        listed = "\n".join(deviations)
        rows.append(f'    ("{name}", [{r:.6}, {l:.6}, {emf:.6}], {supply}, &[\n{listed}\n    ]),')
    write("current_loop.in", __file__, COLUMNS, "&[\n" + "\n".join(rows) + "\n]\n")


if __name__ == "__main__":
    main()
