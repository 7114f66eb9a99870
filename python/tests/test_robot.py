"""Compares robots with independent kinematics and dynamics, computed from the URDF with numpy alone, in
double precision."""

import tomllib
import tracemalloc
from xml.etree import ElementTree

import numpy as np
import pytest
import tesaki

GRAVITY = np.array([0.0, 0.0, -9.81])


def vector(text):
    return np.array([float(part) for part in text.split()])


def turn(axis, angle):
    """Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def origin(element):
    """Returns rotation and translation of an <origin>."""
    if element is None:
        return np.eye(3), np.zeros(3)
    roll, pitch, yaw = vector(element.get("rpy", "0 0 0"))
    rotation = turn(np.array([0, 0, 1]), yaw) @ turn(np.array([0, 1, 0]), pitch) @ turn(np.array([1, 0, 0]), roll)
    return rotation, vector(element.get("xyz", "0 0 0"))


class Urdf:
    def __init__(self, folder):
        self.root = ElementTree.parse(folder / "robot.urdf").getroot()
        self.parents = {joint.find("child").get("link"): joint for joint in self.root.iter("joint")}
        self.links = {link.get("name"): link for link in self.root.iter("link")}
        self.children = {}
        for joint in self.root.iter("joint"):
            self.children.setdefault(joint.find("parent").get("link"), []).append(joint)

    def path(self, tip):
        joints = []
        while tip in self.parents:
            joints.append(self.parents[tip])
            tip = self.parents[tip].find("parent").get("link")
        return joints[::-1]

    def frames(self, tip, angles):
        """Name, rotation and translation of each link on the way to the tip, and the preceding joint axes."""
        rotation, place, axes = np.eye(3), np.zeros(3), []
        for joint in self.path(tip):
            turned, shifted = origin(joint.find("origin"))
            place = place + rotation @ shifted
            rotation = rotation @ turned
            mimic = joint.find("mimic")
            name, ratio, offset = joint.get("name"), 1.0, 0.0
            if mimic is not None:
                name = mimic.get("joint")
                ratio, offset = float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0))
            if joint.get("type") != "fixed":
                axis = vector(joint.find("axis").get("xyz"))
                axes = [*axes, (name, ratio, rotation @ axis, place)]
                rotation = rotation @ turn(axis, ratio * angles[name] + offset)
            yield joint.find("child").get("link"), rotation, place, axes

    def bodies(self, tip, angles):
        """As `frames`, with everything else that the links carry: a gripper, its joints at 0. The base
        carries nothing."""
        path = {joint.get("name") for joint in self.path(tip)}

        def carried(link, rotation, place, axes):
            for joint in self.children.get(link, []):
                if joint.get("name") not in path:
                    turned, shifted = origin(joint.find("origin"))
                    there = joint.find("child").get("link"), rotation @ turned, place + rotation @ shifted, axes
                    yield there
                    yield from carried(*there)

        for frame in self.frames(tip, angles):
            yield frame
            yield from carried(*frame)

    def mass(self, tip, names, angles):
        """Computes the mass matrix of the kinetic energy, body by body, without rotors."""
        matrix = np.zeros((len(names), len(names)))
        for link, rotation, place, axes in self.bodies(tip, angles):
            inertial = self.links[link].find("inertial")
            if inertial is None:
                continue
            turned, shifted = origin(inertial.find("origin"))
            center, rotation = place + rotation @ shifted, rotation @ turned
            i = {key: float(value) for key, value in inertial.find("inertia").attrib.items()}
            tensor = np.array(
                [[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]]
            )
            linear, angular = np.zeros((3, len(names))), np.zeros((3, len(names)))
            for name, ratio, axis, base in axes:
                linear[:, names.index(name)] += ratio * np.cross(axis, center - base)
                angular[:, names.index(name)] += ratio * axis
            mass = float(inertial.find("mass").get("value"))
            matrix += mass * linear.T @ linear + angular.T @ rotation @ tensor @ rotation.T @ angular
        return matrix

    def potential(self, tip, angles):
        energy = 0.0
        for link, rotation, place, _ in self.bodies(tip, angles):
            inertial = self.links[link].find("inertial")
            if inertial is not None:
                center = place + rotation @ origin(inertial.find("origin"))[1]
                energy -= float(inertial.find("mass").get("value")) * GRAVITY @ center
        return energy


def rotors(folder, robot, tip):
    """Returns the inertia of the motors' rotors, from the settings; a joint shared with another finger counts
    there."""
    with open(folder / "controller.toml", "rb") as file:
        settings = tomllib.load(file)
    values = []
    for name in robot.joints_of(tip):
        own = settings.get("joints", {}).get(name, {}).get("motor", {})
        values.append({**settings.get("joint", {}).get("motor", {}), **own}["rotor_inertia"])
        if all(joint.get("name") != name for joint in Urdf(folder).path(tip)):
            # The motor of another finger, which a mimic joint follows.
            values[-1] = 0.0
    return np.diag(values)


def cases():
    for name in ["hand3", "arm7", "hand5", "knob-arm", "inspire"]:
        for tip in tesaki.Robot(tesaki.robots() / name).tips:
            yield name, tip


@pytest.mark.parametrize(("name", "tip"), list(cases()))
def test_against_the_urdf(name, tip):
    folder = tesaki.robots() / name
    robot, urdf = tesaki.Robot(folder), Urdf(folder)
    names = robot.joints_of(tip)
    q = np.random.default_rng(1).uniform(-1, 1, (20, len(names))).astype(np.float32)
    poses, jacobians = robot.fk_jacobian(q, tip)
    np.testing.assert_array_equal(poses, robot.fk(q, tip))
    np.testing.assert_array_equal(jacobians, robot.jacobian(q, tip))
    masses, weights = robot.mass(q, tip), robot.rnea(q, tip=tip, gravity=GRAVITY)
    accelerated = robot.rnea(q, None, q, tip, gravity=[0, 0, 0])
    for row, angles in enumerate(q.astype(float)):
        named = dict(zip(names, angles))
        *_, (_, rotation, place, axes) = urdf.frames(tip, named)
        np.testing.assert_allclose(poses[row, :3], place, atol=2e-6)
        x, y, z, w = poses[row, 3:].astype(float)
        found = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        np.testing.assert_allclose(found, rotation, atol=3e-6)
        expected = np.zeros((6, len(names)))
        for joint, ratio, axis, base in axes:
            expected[:3, names.index(joint)] += ratio * np.cross(axis, place - base)
            expected[3:, names.index(joint)] += ratio * axis
        np.testing.assert_allclose(jacobians[row], expected, atol=3e-6)
        bodies = urdf.mass(tip, names, named)
        np.testing.assert_allclose(masses[row], bodies + rotors(folder, robot, tip), atol=1e-6 + 1e-5 * abs(bodies).max())
        np.testing.assert_allclose(accelerated[row], masses[row] @ angles, atol=1e-5 * (1 + abs(masses[row]).max()))
        for column in range(len(names)):
            energy = []
            for sign in (1, -1):
                moved = dict(named)
                moved[names[column]] += sign * 1e-5
                energy.append(urdf.potential(tip, moved))
            np.testing.assert_allclose(weights[row, column], (energy[0] - energy[1]) / 2e-5, atol=2e-5 + 2e-6 * abs(weights).max())


def test_the_package_has_a_version_and_shows_only_its_own_names():
    assert [part.isdigit() for part in tesaki.__version__.split(".")] == [True] * 3
    assert not hasattr(tesaki, "Path")


def test_inverse_kinematics_come_back():
    robot = tesaki.Robot(tesaki.robots() / "arm7")
    lower, upper = robot.limits[:, 0], robot.limits[:, 1]
    q = np.random.default_rng(2).uniform(0.7 * lower, 0.7 * upper, (50, 7)).astype(np.float32)
    targets = robot.fk(q)
    found, reached, distance, angle = robot.ik(targets)
    assert reached.mean() > 0.95
    assert ((found >= lower) & (found <= upper)).all()
    again = robot.fk(found)
    np.testing.assert_allclose(again[reached, :3], targets[reached, :3], atol=3e-5)
    assert (distance[reached] < 2e-5).all() and (angle[reached] < 2e-5).all()
    _, reached, distance, _ = robot.ik([[9.0, 0.0, 0.0]])
    assert not reached[0] and distance[0] > 5


def test_a_mimic_finger_comes_back():
    robot = tesaki.Robot(tesaki.robots() / "hand5")
    for tip in robot.tips:
        count = len(robot.joints_of(tip))
        targets = robot.fk(np.full((1, count), 0.1), tip)[:, :3]
        found, reached, _, _ = robot.ik(targets, tip)
        assert reached.all(), tip
        np.testing.assert_allclose(robot.fk(found, tip)[:, :3], targets, atol=3e-5)


def allocated(compute):
    """Returns the bytes of arrays that a computation allocates."""
    tracemalloc.start()
    result = compute()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak, result


def test_arrays_are_not_copied():
    robot = tesaki.Robot(tesaki.robots() / "arm7")
    single = np.zeros((100_000, 7), np.float32)
    peak, poses = allocated(lambda: robot.fk(single))
    assert poses.nbytes <= peak < poses.nbytes + 100_000, "nothing but the result"
    peak, _ = allocated(lambda: robot.fk(single.astype(float)))
    assert peak > poses.nbytes + single.nbytes, "double precision is converted"


def test_a_packed_record_is_read_like_an_array():
    robot = tesaki.Robot(tesaki.robots() / "arm7")
    q = np.linspace(-0.5, 0.5, 7, dtype=np.float32).reshape(1, 7)
    at_odd_address = np.frombuffer(b"\0" + q.tobytes(), np.float32, offset=1).reshape(1, 7)
    record = np.zeros(1, np.dtype([("id", "u1"), ("q", "<f4", 7)]))
    record["q"] = q
    for packed in (at_odd_address, record["q"], q.astype(">f4"), np.asfortranarray(q)):
        np.testing.assert_array_equal(robot.fk(packed), robot.fk(q))


def test_wrong_arrays_are_named():
    robot = tesaki.Robot(tesaki.robots() / "hand3")
    q = np.zeros((4, 3), np.float32)
    np.testing.assert_array_equal(robot.fk(q[::2], "finger1_tip"), robot.fk(np.zeros((2, 3)), "finger1_tip"))
    message = r"^q has the shape \(5, 4\), expected \(n, 3\): angles of the joints finger1_swing, .* of finger1_tip$"
    with pytest.raises(ValueError, match=message):
        robot.fk(np.zeros((5, 4)), "finger1_tip")
    with pytest.raises(ValueError, match=r"^q has the shape \(3,\), expected \(n, 3\)"):
        robot.jacobian([0, 0, 0], "finger1_tip")
    with pytest.raises(ValueError, match="^qd has 2 rows, but q has 4: one for each$"):
        robot.rnea(q, q[:2], tip="finger1_tip")
    with pytest.raises(ValueError, match=r"^targets has the shape \(1, 4\), expected \(n, 3\)"):
        robot.ik([[0, 0, 0, 1]], "finger1_tip")
    with pytest.raises(TypeError, match="^q is no array of numbers"):
        robot.fk([["a", "b", "c"]], "finger1_tip")
    for values, why in (
        (np.ma.masked_array(q, mask=True), "it is masked"),
        (q + 0j, "its type is complex64"),
        (q.astype(str), "its type is <U32"),
        ([[0, 0, None]], "its type is object"),
        ([[0, 0], [0]], "setting an array element|inhomogeneous"),
    ):
        with pytest.raises(TypeError, match=f"^q is no array of numbers: .*({why})"):
            robot.fk(values, "finger1_tip")
    with pytest.raises(ValueError, match="^tip is missing: hand3 has the tips finger1_tip, finger2_tip, finger3_tip$"):
        robot.fk(q)
    with pytest.raises(ValueError, match='^tip "thumb" is none: hand3 has the tips finger1_tip'):
        robot.fk(q, "thumb")
    with pytest.raises(ValueError, match="^targets: the quaternion of row 1 has length 2, not 1"):
        robot.ik([[0.1, 0, 0, 0, 0, 0, 1], [0.1, 0, 0, 0, 0, 0, 2]], "finger1_tip")
    with pytest.raises(ValueError, match="^targets: row 0 is not finite"):
        robot.ik([[np.nan, 0, 0]], "finger1_tip")
    with pytest.raises(tesaki.FileError, match="a robot folder holds robot.urdf and controller.toml"):
        tesaki.Robot("/nowhere")


def test_no_posture_is_no_error():
    robot = tesaki.Robot(tesaki.robots() / "arm7")
    assert robot.fk(np.zeros((0, 7))).shape == (0, 7)
    assert robot.jacobian(np.zeros((0, 7))).shape == (0, 6, 7)
    assert robot.ik(np.zeros((0, 3)))[0].shape == (0, 7)


def test_least_grip():
    # Two fingers on opposite faces, a friction of 0.5: 1 N of weight needs 1 N of normal force at each.
    positions, normals = [[-0.02, 0, 0], [0.02, 0, 0]], [[1, 0, 0], [-1, 0, 0]]
    forces, proof = tesaki.least_grip(positions, normals, [0, 0, 1, 0, 0, 0], friction=0.5)
    assert proof is None
    np.testing.assert_allclose(forces, [[1, 0, 0.5], [-1, 0, 0.5]], atol=1e-3)
    forces, proof = tesaki.least_grip(positions, normals, [0, 0, 100, 0, 0, 0], friction=0.5, limit=10)
    assert forces is None and np.isfinite(proof).all()
    # The load has more power along the twist than the strongest forces: 2 · 10 N · 0.5.
    assert proof[2] * 100 > 10 * abs(proof[2])
    with pytest.raises(ValueError, match=r"^normals has the shape \(1, 3\), expected \(2, 3\)"):
        tesaki.least_grip(positions, normals[:1], [0] * 6)
    with pytest.raises(ValueError, match="^contact 1: "):
        tesaki.least_grip(positions, [[1, 0, 0], [0, 0, 0]], [0] * 6)
