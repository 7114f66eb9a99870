#!/usr/bin/env python3
"""Inverse kinematics of the thumb of robots/hand5 (five joints, position of the tip) compared with damped
least squares on Pinocchio in C++: same targets, same starts, same tolerance, same machine, one thread. Prints
a table, makes no file.

Needs a C++ compiler, Eigen's headers (apt-get install g++ libeigen3-dev), the wheel `pin`, which brings headers and
library, numpy, and cargo. The two run alternately, as other work on the machine slows both; the best of all
rounds counts.

4000 tips of random postures each: near: each search starts within 0.1 rad of the posture; cold: at the middle
of the ranges; path: 100 targets per second from one random posture to the next within half a second, each
search starting where the previous one ended. Success is checked here, with the geometry of hand5_retarget.py
in double precision: within 0.05 mm (tolerance of both: 0.01 mm) and within the limits.

Both restart from random postures, at most 30, if they end elsewhere. The peer's damping is Sugihara's (2011),
the squared error times a factor, plus a minimum; of several factors, the table has the fastest among those
with the most successes.
"""

import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin
from hand5_retarget import LIMITS, thumb
from peers_kinematics import processor

HERE = Path(__file__).parent
ROUNDS = 3
TARGETS = 4000
TOLERANCE, CHECKED = 1e-5, 5e-5
FACTORS = 1.0, 10.0
STARTS = "near", "cold", "path"

# The first two axes of the thumb are reversed: the angles have the opposite sign.
PROGRAM = r"""
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <limits>
#include <random>
#include <vector>
using namespace pinocchio;

template <class S> struct Thumb {
  using Joints = Eigen::Matrix<S, 5, 1>;
  using Place = Eigen::Matrix<S, 3, 1>;
  ModelTpl<S> model;
  DataTpl<S> data;
  FrameIndex frame;
  Joints lower, upper;
  Eigen::Matrix<S, 6, 5> jacobian;
  S factor;

  Thumb(const Model & whole, S factor) : model(whole.cast<S>()), data(model), frame(model.getFrameId("tip")), factor(factor) {
    lower << LOWER;
    upper << UPPER;
    jacobian.setZero();
  }

  void search(const Place & target, Joints & q) {
    Joints best = q;
    S least = std::numeric_limits<S>::infinity();
    std::minstd_rand random;
    std::uniform_real_distribution<S> fraction(0, 1);
    for (int start = 0; start <= 30; start++) {
      const S square = solve(target, q);
      if (square < least) least = square, best = q;
      if (square <= S(TOLERANCE * TOLERANCE)) return;
      for (int joint = 0; joint < 5; joint++) q[joint] = lower[joint] + fraction(random) * (upper[joint] - lower[joint]);
    }
    q = best;
  }

  S solve(const Place & target, Joints & q) {
    S square = 0;
    for (int iteration = 0; iteration < 40; iteration++) {
      computeFrameJacobian(model, data, q, frame, LOCAL_WORLD_ALIGNED, jacobian);
      const Place error = target - data.oMf[frame].translation();
      square = error.squaredNorm();
      if (square <= S(TOLERANCE * TOLERANCE)) break;
      const Eigen::Matrix<S, 3, 5> j = jacobian.template topRows<3>();
      Eigen::Matrix<S, 3, 3> damped = j * j.transpose();
      damped.diagonal().array() += factor * square + S(1e-9);
      q = (q + j.transpose() * damped.llt().solve(error)).cwiseMax(lower).cwiseMin(upper);
    }
    return square;
  }
};

template <class S> void run(const Model & whole, double factor, const char * input, const char * output) {
  Thumb<S> thumb(whole, S(factor));
  std::ifstream file(input);
  using Joints = typename Thumb<S>::Joints;
  std::vector<typename Thumb<S>::Place> targets;
  std::vector<Joints> starts;
  for (double v[8]; file >> v[0] >> v[1] >> v[2] >> v[3] >> v[4] >> v[5] >> v[6] >> v[7];) {
    targets.push_back({S(v[0]), S(v[1]), S(v[2])});
    starts.push_back((Joints() << S(-v[3]), S(-v[4]), S(v[5]), S(v[6]), S(v[7])).finished());
  }
  const size_t third = targets.size() / 3;
  std::vector<Joints> solutions(targets.size());
  for (int block = 0; block < 3; block++) {
    double best = 1e9;
    for (int round = 0; round < 5; round++) {
      const size_t first = block * third;
      Joints q = starts[first];
      auto start = std::chrono::steady_clock::now();
      for (size_t i = first; i < first + third; i++) {
        if (block < 2) q = starts[i];
        thumb.search(targets[i], q);
        solutions[i] = q;
      }
      std::chrono::duration<double, std::micro> time = std::chrono::steady_clock::now() - start;
      best = std::min(best, time.count() / third);
    }
    std::printf("%.4f\n", best);
  }
  std::ofstream out(output);
  out.precision(9);
  for (const auto & q : solutions) out << -q[0] << ' ' << -q[1] << ' ' << q[2] << ' ' << q[3] << ' ' << q[4] << '\n';
}

int main(int, char ** arguments) {
  Model model;
  const auto at = [](double x, double y, double z) { return SE3(Eigen::Matrix3d::Identity(), Eigen::Vector3d(x, y, z)); };
  model.addJoint(0, JointModelRZ(), at(0.010, 0.022, 0.020), "1");
  model.addJoint(1, JointModelRX(), at(0, 0, 0), "2");
  model.addJoint(2, JointModelRY(), at(0, 0, 0.04622), "3");
  model.addJoint(3, JointModelRX(), at(0, 0, 0), "4");
  model.addJoint(4, JointModelRX(), at(0, 0, 0.03157), "5");
  model.addFrame(Frame("tip", 5, 0, at(0, 0, 0.02734), OP_FRAME));
  const double factor = std::atof(arguments[2]);
  if (arguments[1][0] == 'f') run<float>(model, factor, arguments[3], arguments[4]);
  else run<double>(model, factor, arguments[3], arguments[4]);
}
"""


def targets():
    """Returns positions of the tip and starts, for each of STARTS."""
    rng = np.random.default_rng(7)
    lower, upper = LIMITS[:5].T
    random = lambda number: rng.uniform(lower, upper, (number, 5))
    near, cold, stops = random(TARGETS), random(TARGETS), random(TARGETS // 50 + 1)
    s = np.arange(50)[:, None] / 50
    s = s * s * (3 - 2 * s)
    path = np.concatenate([a + (b - a) * s for a, b in zip(stops, stops[1:])])
    beside = np.clip(near + rng.uniform(-0.1, 0.1, near.shape), lower, upper)
    starts = [beside, np.tile((lower + upper) / 2, (TARGETS, 1)), path]
    return np.array([thumb(q) for q in np.concatenate([near, cold, path])]), np.concatenate(starts)


def build(folder):
    signs = np.array([-1, -1, 1, 1, 1])
    ends = np.sort(LIMITS[:5] * signs[:, None], axis=1)
    text = PROGRAM.replace("TOLERANCE", repr(TOLERANCE))
    for name, values in zip(("LOWER", "UPPER"), ends.T):
        text = text.replace(name, ", ".join(map(repr, values.tolist())))
    prefix = Path(sysconfig.get_path("purelib")) / "cmeel.prefix"
    source, peer = folder / "peer.cpp", folder / "peer"
    source.write_text(text)
    # As in the wheel's CMake files.
    limits = "MPL_LIMIT_LIST_SIZE=30", "MPL_LIMIT_VECTOR_SIZE=30", "FUSION_INVOKE_MAX_ARITY=12"
    flags = ["-O3", "-DNDEBUG", "-std=c++17"]
    flags += [f"-DBOOST_{limit}" for limit in (*limits, "MPL_CFG_NO_PREPROCESSED_HEADERS")]
    includes = [f"-I{prefix}/include", "-I/usr/include/eigen3"]
    libraries = [f"-L{prefix}/lib", f"-Wl,-rpath,{prefix}/lib", "-lpinocchio_default"]
    subprocess.run(["g++", *flags, *includes, source, "-o", peer, *libraries], check=True)
    cargo = ["cargo", "build", "--quiet", "--release", "-p", "tesaki", "--features", "test-support"]
    subprocess.run([*cargo, "--example", "thumb_speed"], check=True, cwd=HERE)
    target = os.environ.get("CARGO_TARGET_DIR", HERE / "../../target")
    return peer, Path(target) / "release/examples/thumb_speed"


def judged(places, file):
    """Returns the fraction of successes, by start."""
    lower, upper = LIMITS[:5].T
    solutions = np.loadtxt(file)
    errors = np.array([np.linalg.norm(thumb(q) - place) for q, place in zip(solutions, places)])
    inside = np.all((solutions >= lower - 1e-5) & (solutions <= upper + 1e-5), axis=1)
    return ((errors <= CHECKED) & inside).reshape(3, TARGETS).mean(axis=1)


def main():
    places, starts = targets()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        np.savetxt(folder / "targets", np.hstack([places, starts]), fmt="%.9g")
        peer, own = build(folder)
        programs = {"tesaki": [own]} | {
            f"{scalar} {factor:g}": [peer, scalar, repr(factor)] for scalar in ("float", "double") for factor in FACTORS
        }
        best, success = {name: np.full(3, np.inf) for name in programs}, {}
        for _ in range(ROUNDS):
            for name, command in programs.items():
                command = [*command, folder / "targets", folder / "out"]
                out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
                best[name] = np.minimum(best[name], [float(line) for line in out.split()])
                success[name] = judged(places, folder / "out")
    print(f"{processor()}; Pinocchio {pin.__version__}; a search on average, the best of {ROUNDS} turns; success")
    print(f"{'':24}" + "".join(f"{start:>22}" for start in STARTS))
    for scalar in ("tesaki", "float", "double"):
        names = [name for name in programs if name.split()[0] == scalar]
        row = f"{'tesaki' if scalar == 'tesaki' else f'least squares, {scalar}':24}"
        for start in range(3):
            name = min(names, key=lambda name: (-success[name][start], best[name][start]))
            row += f" {best[name][start]:8.2f} µs {100 * success[name][start]:7.3f} %"
        print(row)


if __name__ == "__main__":
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    sys.exit(main())
