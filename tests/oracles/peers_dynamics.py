#!/usr/bin/env python3
"""Compares the times of Pinocchio's dynamics in C++ with the core's: same arm, same machine, one thread.
Prints a table.

Needs a C++ compiler, Eigen's headers (apt-get install g++ libeigen3-dev), the wheel `pin`, which brings headers and
library, and cargo. The two run alternately, as other work on the machine slows both; the best of all rounds
counts. The arm is the Franka Panda of data/inverse_dynamics.in, at the first of its motions. The C++ program
is compiled for the same processors as Rust's default (x86-64), or for this one with --native.
"""

import ast
import os
import re
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin
from peers_kinematics import processor

HERE = Path(__file__).parent
ROUNDS = 6

PROGRAM = r"""
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <chrono>
#include <cstdio>
using namespace pinocchio;

template <class F> void measure(const char * scalar, const char * name, F body) {
  double best = 1e9;
  for (int round = 0; round < 10; round++) {
    auto start = std::chrono::steady_clock::now();
    for (int i = 0; i < 20000; i++) {
      body();
      asm volatile("" ::: "memory");
    }
    std::chrono::duration<double, std::nano> time = std::chrono::steady_clock::now() - start;
    best = std::min(best, time.count() / 20000);
  }
  std::printf("%s %s %.1f\n", scalar, name, best);
}

template <class S> void run(const Model & whole, const char * scalar) {
  using Vector = Eigen::Matrix<S, Eigen::Dynamic, 1>;
  using Matrix = Eigen::Matrix<S, 6, Eigen::Dynamic>;
  ModelTpl<S> model = whole.cast<S>();
  DataTpl<S> data(model);
  const auto frame = model.getFrameId("tip");
  const auto axes = LOCAL_WORLD_ALIGNED;
  Vector q(model.nv), v(model.nv), a(model.nv);
  q << Q; v << V; a << A;
  std::vector<ForceTpl<S>> wrenches(model.njoints, ForceTpl<S>::Zero());
  wrenches.back().toVector() << WRENCH;
  Matrix j(6, model.nv), dj(6, model.nv);
  const Vector zero = Vector::Zero(model.nv);
  measure(scalar, "rnea", [&] { rnea(model, data, q, v, a); });
  measure(scalar, "rnea_wrench", [&] { rnea(model, data, q, v, a, wrenches); });
  measure(scalar, "mass_matrix", [&] { crba(model, data, q, Convention::LOCAL); });
  measure(scalar, "jacobian_and_bias", [&] {
    forwardKinematics(model, data, q, v, zero);
    computeJointJacobians(model, data);
    updateFramePlacement(model, data, frame);
    j.setZero();
    getFrameJacobian(model, data, frame, axes, j);
    dj.col(0) = getFrameClassicalAcceleration(model, data, frame, axes).toVector();
  });
  measure(scalar, "jacobian_and_derivative", [&] {
    computeJointJacobiansTimeVariation(model, data, q, v);
    updateFramePlacement(model, data, frame);
    j.setZero();
    dj.setZero();
    getFrameJacobian(model, data, frame, axes, j);
    getFrameJacobianTimeVariation(model, data, frame, axes, dj);
  });
}

int main() {
  Model model;
  const auto place = [](double x, double y, double z, double qx, double qy, double qz, double qw) {
    return SE3(Eigen::Quaterniond(qw, qx, qy, qz).normalized().toRotationMatrix(), Eigen::Vector3d(x, y, z));
  };
  JOINTS
  model.gravity.linear() << GRAVITY;
  run<double>(model, "double");
  run<float>(model, "float");
}
"""


def arm():
    """Reads the Panda of the data file, whose Rust tuples and arrays are valid Python."""
    lines = (HERE / "data/inverse_dynamics.in").read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith("//"))
    return next(case for case in ast.literal_eval(text.replace("&", "")) if case[0] == "franka_panda")


def program():
    def listed(values):
        return ", ".join(repr(float(value)) for value in values)

    _, gravity, joints, tip, motions = arm()
    lines = []
    for i, (xyz, quaternion, axis, mass, center, inertia, rotor) in enumerate(joints):
        assert axis == [0.0, 0.0, 1.0], "JointModelRZ is the fastest"
        xx, yy, zz, xy, xz, yz = inertia
        tensor = f"(Eigen::Matrix3d() << {listed([xx, xy, xz, xy, yy, yz, xz, yz, zz])}).finished()"
        body = f"Inertia({mass!r}, Eigen::Vector3d({listed(center)}), {tensor})"
        lines += [
            f'model.addJoint({i}, JointModelRZ(), place({listed(xyz + quaternion)}), "j{i}");',
            f"model.appendBodyToJoint({i + 1}, {body}, SE3::Identity());",
            f"model.armature[{i}] = {rotor!r};",
        ]
    lines.append(f'model.addFrame(Frame("tip", {len(joints)}, 0, place({listed(tip[0] + tip[1])}), OP_FRAME));')
    q, v, a, wrench = motions[0][:4]
    values = dict(JOINTS="\n  ".join(lines), GRAVITY=listed(gravity), WRENCH=listed(wrench), Q=listed(q), V=listed(v), A=listed(a))
    return re.sub(r"\b(JOINTS|GRAVITY|WRENCH|Q|V|A)\b", lambda match: values[match[0]], PROGRAM)


def build(folder, native):
    prefix = Path(sysconfig.get_path("purelib")) / "cmeel.prefix"
    source, peer = folder / "peer.cpp", folder / "peer"
    source.write_text(program())
    flags = ["-O3", "-DNDEBUG", "-std=c++17"] + ["-march=native"] * native
    # As in the wheel's CMake files.
    limits = "MPL_LIMIT_LIST_SIZE=30", "MPL_LIMIT_VECTOR_SIZE=30", "FUSION_INVOKE_MAX_ARITY=12"
    flags += [f"-DBOOST_{limit}" for limit in (*limits, "MPL_CFG_NO_PREPROCESSED_HEADERS")]
    includes = [f"-I{prefix}/include", "-I/usr/include/eigen3"]
    libraries = [f"-L{prefix}/lib", f"-Wl,-rpath,{prefix}/lib", "-lpinocchio_default"]
    subprocess.run(["g++", *flags, *includes, source, "-o", peer, *libraries], check=True)
    cargo = ["cargo", "build", "--quiet", "--release", "-p", "tesaki", "--example", "dynamics_speed"]
    subprocess.run(cargo, check=True, cwd=HERE)
    target = os.environ.get("CARGO_TARGET_DIR", HERE / "../../target")
    return peer, Path(target) / "release/examples/dynamics_speed"


def times(peer, own):
    best = {}
    for _ in range(ROUNDS):
        for program, prefix in ((peer, ""), (own, "own ")):
            for line in subprocess.run([program], check=True, capture_output=True, text=True).stdout.splitlines():
                name, value = (prefix + line).rsplit(" ", 1)
                best[name] = min(best.get(name, np.inf), float(value))
    return best


if __name__ == "__main__":
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as folder:
        best = times(*build(Path(folder), "--native" in sys.argv))
    print(f"{processor()}; Pinocchio {pin.__version__}; nanoseconds a call, the best of {ROUNDS} turns")
    print(f"{'':24} {'here':>6} {'float':>7} {'double':>7} {'here/float':>11}")
    for name in ("rnea", "rnea_wrench", "mass_matrix", "jacobian_and_bias", "jacobian_and_derivative"):
        here = best.get(f"own {name}", best["own jacobian_and_bias"])
        single, double = best[f"float {name}"], best[f"double {name}"]
        print(f"{name:24} {here:6.0f} {single:7.0f} {double:7.0f} {here / single:11.2f}")
