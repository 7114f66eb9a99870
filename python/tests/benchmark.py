"""The speed of the package: a batch compared with Rust, and steps of a scenario compared with real time.

``cargo xtask python --speed`` builds the package and runs this. Times are for one core; the best of several
rounds counts, because other programs take time, too.
"""

import time

import numpy as np
import tesaki
from tesaki import sim

BATCH = 100_000
PERIOD = 0.01  # s, of control


def batch():
    """Compares poses and Jacobians of a batch with the same loop in Rust, in alternation."""
    robot = tesaki.Robot(tesaki.robots() / "arm7")
    q = np.random.default_rng(3).uniform(-1, 1, (BATCH, 7)).astype(np.float32)
    rust, python = [], []
    for _ in range(15):
        rust.append(robot._time_fk_jacobian(q))
        start = time.perf_counter()
        robot.fk_jacobian(q)
        python.append(time.perf_counter() - start)
    return min(python), min(rust)


def step():
    """Measures a step of hand3-servo: 10 ms of plant and control core."""
    env = sim.make("hand3-servo")
    observation, _ = env.reset(seed=1)
    goal, best = observation["position"], np.inf
    for _ in range(8):
        start = time.perf_counter()
        for _ in range(50):
            env.step(goal)
        best = min(best, (time.perf_counter() - start) / 50)
    return best


if __name__ == "__main__":
    python, rust = batch()
    print(f"poses and Jacobians of {BATCH} postures of arm7: {1e3 * python:.1f} ms, {python / rust:.2f} times Rust")
    taken = step()
    print(f"a step of hand3-servo: {1e3 * taken:.3f} ms, {PERIOD / taken:.0f} times real time")
