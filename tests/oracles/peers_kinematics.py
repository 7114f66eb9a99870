#!/usr/bin/env python3
"""Times of other libraries' kinematics on this machine, on one thread: prints tables, makes no file.

Runs what is installed, because the two may need separate environments:

    pip install pin                            # forward kinematics with Jacobian of the Panda
    pip install roboticstoolbox-python         # inverse kinematics of the UR5e: ik_LM, its core in C++

Pinocchio is timed through Python, so the call's own cost is part of it; the same call on the first few joints
of the same arm, down to a model without joints, shows how much.
"""

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import platform
import time
from itertools import repeat
from pathlib import Path

import numpy as np

ROBOTS = Path(__file__).parent / "../robots"


def processor():
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":")[1].strip()
    return platform.processor()


def best_time(function, calls, repetitions=30):
    """Returns the time per call [s], the best of several repetitions."""
    best = np.inf
    for _ in range(repetitions):
        start = time.perf_counter()
        for _ in repeat(None, calls):
            function()
        best = min(best, time.perf_counter() - start)
    return best / calls


def forward(pin):
    print(f"\nPinocchio {pin.__version__}, double precision: computeFrameJacobian, forward kinematics included")
    whole = pin.buildModelFromUrdf(str(ROBOTS / "franka_panda.urdf"))
    tip = whole.frames[whole.getFrameId("panda_hand_tcp")]
    loop = best_time(lambda: None, 100_000)
    print(f"{'joints':>6} {'µs a call':>10} {'less the empty model':>21}")
    empty = None
    for n in range(8):
        model = pin.Model()
        for i in range(1, n + 1):
            model.addJoint(i - 1, whole.joints[i], whole.jointPlacements[i], whole.names[i])
        frame = model.addFrame(pin.Frame("tip", n, 0, tip.placement, pin.FrameType.OP_FRAME))
        data, q = model.createData(), np.linspace(-1, 1, n)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        seconds = best_time(lambda: pin.computeFrameJacobian(model, data, q, frame, axes), 20_000) - loop
        empty = seconds if empty is None else empty
        print(f"{n:6} {seconds * 1e6:10.3f} {(seconds - empty) * 1e6:21.3f}")


def inverse(rtb):
    from roboticstoolbox.ets.fknm import _c_IK_LM_c as IK_LM_c

    print(f"\nRobotics Toolbox {rtb.__version__}, ik_LM (C++ core called without its wrapper), UR5e, 1000 targets")
    robot = rtb.Robot.URDF(str((ROBOTS / "ur5e.urdf").resolve()))
    ets = robot.ets(end="tool0").compile()
    lower, upper = ets.qlim
    rng = np.random.default_rng(23)
    solutions = rng.uniform(lower, upper, (1000, 6))
    targets = [np.asfortranarray(ets.fkine(q).A) for q in solutions]
    starts = {
        "fixed": np.tile([0, -1.2, 1.2, -1.5, -1.5, 0.0], (1000, 1)),
        "near": np.clip(solutions + rng.uniform(-0.1, 0.1, solutions.shape), lower, upper),
    }
    mask = np.ones(6)

    def solve(target, start, tolerance, searches, method, damping):
        return IK_LM_c(ets._fknm, target, start, 30, searches, tolerance, 1, mask, damping, method)

    none = best_time(lambda: solve(targets[0], solutions[0], 1e-6, 1, "chan", 1.0), 1000, 10)
    print(f"start at the solution (cost of the call and one pose): {none * 1e6:.2f} µs")
    print("tolerance: on half the squared error, 1e-6 is 1.4 mm or mrad, 1e-12 1.4 µm or µrad")
    print("tight: pose within 1e-5 m and rad; times: over all targets, of the fastest of 5 runs")
    header = f"{'start':6} {'searches':>8} {'method':9} {'damping':>7} {'tol.':>6} {'success':>8} {'tight':>6}"
    print(f"{header} {'median µs':>10} {'mean µs':>9} {'99 % µs':>9} {'iterations':>10}")
    for tolerance in (1e-6, 1e-12):
        for name, searches in (("fixed", 1), ("fixed", 100), ("near", 1), ("near", 100)):
            for method, damping in (("chan", 1.0), ("sugihara", 1e-4)):
                times, good, tight, iterations = np.empty((5, 1000)), 0, 0, []
                for run in range(5):
                    for i in range(1000):
                        start = time.perf_counter()
                        found = solve(targets[i], starts[name][i], tolerance, searches, method, damping)
                        times[run, i] = time.perf_counter() - start
                        if run == 0:
                            q, success, steps, _, _ = found
                            good += bool(success)
                            iterations.append(steps)
                            tight += bool(success) and np.abs(ets.fkine(q).A - targets[i]).max() < 1e-5
                times = times[times.mean(axis=1).argmin()] * 1e6
                row = f"{name:6} {searches:8} {method:9} {damping:7} {tolerance:6.0e}"
                row += f" {good / 10:7.1f}% {tight / 10:5.1f}%"
                row += f" {np.median(times):10.1f} {times.mean():9.1f} {np.percentile(times, 99):9.1f}"
                print(f"{row} {np.mean(iterations):10.1f}")


if __name__ == "__main__":
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    print(f"{processor()}, Python {platform.python_version()}, NumPy {np.__version__}")
    for part, module in ((forward, "pinocchio"), (inverse, "roboticstoolbox")):
        try:
            library = __import__(module)
        except ImportError:
            print(f"\n{module} is not installed: skipped")
        else:
            part(library)
