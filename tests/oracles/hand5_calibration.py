"""Writes data/hand5_calibration.in: link calibration of human fingers in double precision. Fingers with hinges whose axes are
tilted at random take poses; SciPy's Rotation makes their orientations and tips. NumPy's singular value decomposition of the whole
stacked matrix [I, R1, R1R2, R1R2R3] gives the solution of minimum norm, truncated where the case says; for the cases with a prior
NumPy's least squares of the stacked equations."""

import numpy as np
from scipy.spatial.transform import Rotation

from data_file import write

COLUMNS = """
Cases: (name, orientation noise [rad], marker noise [m], standard deviation of the prior [m] or 0, forgetting,
poses [([back, segment 1, 2, 3: quaternions x, y, z, w], marker [m])],
largest and smallest singular value kept, rank, rms residual [m],
mean of the prior [m], probes [([R1, R1R2, R1R2R3: quaternions], tip predicted [m])], true links [m]).
"""

random = np.random.default_rng(5)


def finger(noise, marker_noise, poses, spread=0.2):
    """Returns links, quaternions of each pose with noise, and markers."""
    links = np.array([[0.09, 0.02, 0.0], [0.042, 0.002, -0.003], [0.025, -0.002, 0.002], [0.02, 0.001, -0.004]])
    links += 0.003 * random.normal(size=(4, 3))
    tilt = [Rotation.from_rotvec(0.1 * random.normal(size=3)) for _ in range(3)]
    mount = [Rotation.from_rotvec(0.1 * random.normal(size=3)) for _ in range(3)]

    def relative(angles):
        base, side, middle, end = angles
        joints = [Rotation.from_euler("ZY", [side, base]), Rotation.from_euler("Y", middle), Rotation.from_euler("Y", end)]
        made, so_far = [], Rotation.identity()
        for tilted, joint, mounted in zip(tilt, joints, mount):
            so_far = so_far * (tilted * joint * tilted.inv())
            made.append(so_far * mounted)
        return made

    def tip(rotations):
        return links[0] + sum(r.apply(l) for r, l in zip(rotations, links[1:]))

    rows = []
    for number in range(poses):
        middle = random.uniform(0, 1.6)
        angles = [random.uniform(0, 1.4), random.uniform(-spread, spread), middle, 2 / 3 * middle + random.uniform(-0.15, 0.15)]
        rotations = relative(np.array(angles) * (number > 0))
        back = Rotation.random(random_state=random)
        absolute = [back] + [back * r for r in rotations]
        measured = [Rotation.from_rotvec(noise / np.sqrt(3) * random.normal(size=3)) * r for r in absolute]
        rows.append(([r.as_quat() for r in measured], tip(rotations) + marker_noise * random.normal(size=3)))
    probes = [relative([random.uniform(0, 1.4), random.uniform(-spread, spread), random.uniform(0, 1.6), random.uniform(0, 1)]) for _ in range(12)]
    return links, rows, [[r.as_quat() for r in probe] for probe in probes]


def stacked(rows):
    blocks, right = [], []
    for quaternions, marker in rows:
        back, *segments = (Rotation.from_quat(q) for q in quaternions)
        blocks.append(np.hstack([np.eye(3)] + [(back.inv() * s).as_matrix() for s in segments]))
        right.append(marker)
    return np.vstack(blocks), np.hstack(right)


def text(values, digits=9):
    return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"


def case(name, noise, marker_noise, poses, prior=0.0, forgetting=1.0, spread=0.2):
    links, rows, probes = finger(noise, marker_noise, poses, spread)
    matrix, right = stacked(rows)
    weights = np.repeat(forgetting ** np.arange(poses - 1, -1, -1.0), 3)
    matrix, right = matrix * np.sqrt(weights)[:, None], right * np.sqrt(weights)
    mean = links + 0.004 * random.normal(size=(4, 3)) if prior else np.zeros((4, 3))
    total = weights.sum() / 3
    if prior:
        # Standard deviation of an equation: that of the marker, and that of the orientations with each link
        # as lever.
        deviation = np.sqrt(marker_noise**2 + 4 / 9 * noise**2 * (mean[1:] ** 2).sum())
        matrix = np.vstack([matrix, np.eye(12) * deviation / prior])
        right = np.hstack([right, mean.ravel() * deviation / prior])
        threshold = 0.0
    else:
        threshold = max(1.5 * (1 + 2 / np.sqrt(total)) * noise * np.sqrt(2 / 3 * total), 1e-4 * np.sqrt(total))
    u, sigma, v = np.linalg.svd(matrix, full_matrices=False)
    kept = sigma > threshold
    x = v[kept].T @ ((u[:, kept].T @ right) / sigma[kept])
    residual = np.sqrt(((right - matrix @ x) ** 2).sum() / total)
    print(name, "rank", kept.sum(), "kept", sigma[kept][-1], "threshold", threshold, "next", sigma[~kept][:1], "residual", residual)
    poses = ", ".join(f"([{', '.join(text(q) for q in quaternions)}], {text(marker)})" for quaternions, marker in rows)
    found = []
    for quaternions in probes:
        rotations = [Rotation.from_quat(q) for q in quaternions]
        l = x.reshape(4, 3)
        p = l[0] + sum(r.apply(link) for r, link in zip(rotations, l[1:]))
        found.append(f"([{', '.join(text(q) for q in quaternions)}], {text(p)})")
    links, mean = (f"[{', '.join(text(l) for l in ls)}]" for ls in (links, mean))
    return (
        f'("{name}", {noise}, {marker_noise}, {prior}, {forgetting}, &[{poses}], [{sigma[0]:.6f}, {sigma[kept][-1]:.6f}], '
        f"{kept.sum()}, {residual:.9f}, {mean}, &[{', '.join(found)}], {links}),\n"
    )


cases = [
    case("exact, spread", 0.0, 1e-6, 20),
    case("exact, not spread", 0.0, 1e-6, 20, spread=0.0),
    case("four poses", 0.0, 1e-6, 4),
    case("noise", 0.0262, 3e-4, 60),
    case("noise of means over a second", 0.006, 3e-4, 24),
    case("forgetting", 0.006, 3e-4, 60, forgetting=0.95),
    case("prior", 0.006, 3e-4, 6, prior=0.004),
]
write("hand5_calibration.in", __file__, COLUMNS, "&[\n" + "".join(cases) + "]\n")
