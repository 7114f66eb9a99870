"""Circles of a rose seen by a camera in a hand, and SciPy's estimate from them.

A rose on a wall is seen from random postures: points on its rim are projected one by one, and the ellipse through them
is fitted algebraically. To centre and radius (root of the product of the semi-axes) normally distributed noise is added;
some rows have the circle of a knob's end in place of that of the rose. Camera and rose are estimated by
`scipy.optimize.least_squares`, first with Cauchy's loss, then without the rows with errors of more than 4.5
standard deviations; the standard deviations come from the Jacobian. Writes data/hand_eye.in: the circles, and
the values that `tesaki_supervisor::hand_eye::calibrate` must find in them.

    python3 tests/oracles/hand_eye.py
"""

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from data_file import write

COLUMNS = """
A rose of 0.04 m in pictures of 256 x 240 pixels.
Rows: position of the hand [m], quaternion x, y, z, w, centre and radius of the circle [px].
(Value, standard deviation) of the camera's position x, y, z [m], tilt, pan, turn [rad], focal length [px];
the same of the rose's centre [m]; indices of the rows that do not fit; root mean square of centres and radii [px].
"""
ROSE, KNOB, PRINCIPAL = 0.04, 0.025, np.array([127.5, 119.5])
# Position, tilt, pan, turn, focal length, centre of the rose, slopes of its axis.
TRUTH = np.array([0.052, 0.003, -0.118, 0.17, -0.02, 0.05, 143.0, 0.93, 0.1, 0.15, 0.03, -0.02])
NOISE, ROWS, WRONG = 0.2, 32, (5, 20)


def axes(values):
    """Returns the normal of the rose, which is on a wall across the base's x, and two directions in its
    plane."""
    normal = np.array([1.0, values[10], values[11]])
    normal /= np.linalg.norm(normal)
    first = np.cross(normal, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    return normal, first, np.cross(normal, first)


def circle(values, position, quaternion, radius=ROSE, before=0.0):
    """Returns centre and radius in the picture of a rim at this distance in front of the rose."""
    normal, first, second = axes(values)
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)[:, None]
    rim = values[7:10] - before * normal + radius * (np.cos(angles) * first + np.sin(angles) * second)
    in_hand = (rim - position) @ Rotation.from_quat(quaternion).as_matrix()
    # Columns: right, down and ahead in the hand frame. The tilt turns the level camera about the hand's y, the pan about
    # its own y, the turn about its own z.
    level = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    tilt, pan, turn = values[3:6]
    mount = Rotation.from_euler("y", -tilt).as_matrix() @ level @ Rotation.from_euler("YZ", [pan, -turn]).as_matrix()
    in_camera = (in_hand - values[:3]) @ mount
    if in_camera[:, 2].min() < 0.01:
        return np.full(3, np.nan)
    x, y = (in_camera[:, :2] / in_camera[:, 2:]).T
    # a x^2 + b xy + c y^2 + d x + e y = 1, in scaled coordinates about the mean.
    middle, scale = np.array([x.mean(), y.mean()]), np.hypot(x - x.mean(), y - y.mean()).max()
    x, y = (x - middle[0]) / scale, (y - middle[1]) / scale
    a, b, c, d, e = np.linalg.lstsq(np.stack([x * x, x * y, y * y, x, y], axis=1), np.ones_like(x), rcond=None)[0]
    form = np.array([[a, b / 2.0], [b / 2.0, c]])
    center = np.linalg.solve(-2.0 * form, [d, e])
    # (p - m)' form (p - m) = level; the semi-axes are roots of level over the eigenvalues.
    level = 1.0 + center @ form @ center
    size = np.sqrt(level / np.sqrt(np.linalg.det(form)))
    return np.append(PRINCIPAL + values[6] * (middle + scale * center), values[6] * scale * size)


def draw(rng):
    rows = []
    upright = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
    while len(rows) < ROWS:
        distance = rng.uniform(0.04, 0.28)
        aside = rng.uniform(-0.3, 0.3, 2) * (distance + 0.1)
        position = TRUTH[7:10] + [-distance, *aside]
        turn = Rotation.from_rotvec(rng.uniform(-1.0, 1.0, 3) * [0.2, 0.2, 0.4])
        quaternion = (Rotation.from_matrix(upright) * turn).as_quat()
        wrong = len(rows) in WRONG
        seen = circle(TRUTH, position, quaternion, *((KNOB, 0.055) if wrong else ()))
        inside = all(seen[2] < place < side - seen[2] for place, side in zip(seen, (256, 240)))
        if inside:
            numbers = np.concatenate([position, quaternion, seen + rng.normal(0.0, NOISE, 3)])
            # The rounded values of the file are also used for the solution.
            rows.append(np.round(numbers, 9))
    return np.array(rows)


def residuals(values, rows):
    return np.array([circle(values, row[:3], row[3:7]) - row[7:] for row in rows])


def main():
    rows = draw(np.random.default_rng(20))
    start = TRUTH + [0.01, -0.01, 0.01, 0.03, 0.03, -0.03, 10.0, 0.01, -0.01, 0.01, 0.02, 0.02]
    solve = lambda start, rows, **loss: least_squares(
        lambda values: residuals(values, rows).ravel(), start, x_scale=np.abs(start) + 0.01, xtol=1e-15, ftol=1e-15,
        gtol=1e-15, **loss)
    values = solve(start, rows, loss="cauchy", f_scale=1.0).x
    kept = np.full(ROWS, True)
    for _ in range(10):
        offsets = np.linalg.norm(residuals(values, rows), axis=1)
        kept = offsets <= 4.5 * np.median(offsets) / 1.538
        found = solve(values, rows[kept])
        values = found.x
    rest = residuals(values, rows[kept])
    variance = (rest**2).sum() / (rest.size - len(values))
    deviations = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * variance)
    print("off, over the standard deviation:", np.round((values - TRUTH) / deviations, 2))
    pairs = [f"({value:.9f}, {deviation:.9f})" for value, deviation in zip(values, deviations)]
    rms = [np.sqrt((rest[:, :2] ** 2).sum() / kept.sum()), np.sqrt((rest[:, 2] ** 2).mean())]
    lines = "".join(f"        [{', '.join(f'{number:.9f}' for number in row)}],\n" for row in rows)
    text = f"(\n    &[\n{lines}    ],\n    [{', '.join(pairs[:7])}],\n    [{', '.join(pairs[7:10])}],\n"
    text += f"    &{[int(row) for row in np.flatnonzero(~kept)]},\n    [{rms[0]:.9f}, {rms[1]:.9f}],\n)\n"
    write("hand_eye.in", __file__, COLUMNS, text)


main()
