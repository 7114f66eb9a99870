"""Parts of the messages of docs/protocol.md, encoded, and what the golden frames of `protocol.py` hold."""

import struct

from protocol_encoding import (
    boolean, byte, key, option, real, reals, sequence, sint, text, uint,
)

SCHEMA = 0x0123456789ABCDEF
STATE = 0xFEDCBA9876543210
CLIENT = 0xC0FFEE
IMAGE = "1f2e3d4c5b6a7988"
BOARD = "300021000d51363034333832"
FIRMWARE = byte(0) + byte(1) + byte(0)
IDENTITY = FIRMWARE + key(IMAGE) + key(BOARD) + uint(29)

# Tasks, and modes.
JOINT_SERVO, GRASPING, IMPEDANCE, TELEXISTENCE, VISUAL_APPROACH = map(uint, range(5))
TASKS = {"joint-servo": JOINT_SERVO, "grasping": GRASPING, "impedance": IMPEDANCE,
         "telexistence": TELEXISTENCE, "visual-approach": VISUAL_APPROACH}
DISABLED, FAULT = uint(0), uint(2)


def enabled(task):
    return uint(1) + task


# Requests.
(HELLO, DISABLE, STOP, TAKE_COMMAND, RELEASE_COMMAND, MODEL_BEGIN, MODEL_CHUNK, MODEL_COMMIT, HOME, TARE,
 ENABLE, TASK, KEEP, READ_TASK, READ_STATUS, READ_FAULTS, CLEAR_FAULTS, SET_RATE, EXPORT,
 READ_EXPORT) = map(uint, range(20))


def fault(cause, joint, value, limit, tick):
    joint = option(None if joint is None else byte(joint))
    return uint(cause) + joint + real(value) + real(limit) + uint(tick)


def frame_counts(good, overlong, framing, checksum, malformed):
    return uint(good) + uint(overlong) + uint(framing) + uint(checksum) + uint(malformed)


NO_STATISTICS = frame_counts(0, 0, 0, 0, 0) + uint(0) + uint(0) + uint(0)


def node_status(mode, model, checksum, homed, faults, faults_read, commander, tick, supply):
    return (mode + text(model) + uint(checksum) + uint(homed) + uint(faults) + boolean(faults_read)
            + option(None if commander is None else uint(commander)) + uint(tick) + real(supply))


def board_status(clock, reset, words, stack_used, stack_size, supervisor, plant):
    return (IDENTITY + uint(clock) + uint(reset) + text(words) + uint(stack_used) + uint(stack_size)
            + supervisor + plant)


QUIET_BOARD = board_status(0, 0, "", 0, 0, NO_STATISTICS, NO_STATISTICS)


def sensors(number, flags, supply, encoders, currents, forces=()):
    return (uint(number) + byte(flags) + uint(supply) + sequence(map(sint, encoders))
            + sequence(map(sint, currents)) + sequence(b"".join(map(sint, six)) for six in forces))


def actuators(number, enabled, torques):
    return uint(number) + boolean(enabled) + sequence(map(real, torques))


def telemetry(tick, mode, faults, joints):
    return uint(tick) + mode + uint(faults) + sequence(map(reals, joints))


def request(number, what, client=CLIENT):
    return uint(client) + uint(number) + what


def reply(number, tick, what, client=CLIENT):
    return uint(0) + uint(client) + uint(number) + uint(tick) + what


def model(reaction):
    """A robot of one joint."""
    joint = (
        text("knuckle")
        + reals([0.0, 0.0, 0.1]) + reals([0.0, 0.0, 0.0, 1.0])  # origin
        + reals([0.0, 0.0, 1.0])  # axis
        + real(0.02) + reals([0.02, 0.0, 0.0]) + reals([1e-6, 5e-6, 5e-6, 0.0, 0.0, 0.0])  # link
        + reals([2e-4, 0.5, 1.5, 1e-3, 300.0, 3e-4]) + option(real(6.0)) + option(None)  # motor
        + reals([0.02, 0.002])  # friction
        + real(65536.0) + boolean(False) + sint(-40) + boolean(True)  # encoder
        + reals([-1.5, 1.5, 8.0, 0.6, 200.0, 0.25])  # limits
        + real(0.2) + reals([0.4, 1.0, 0.01, 30.0]) + reals([2.1e-4, 50.0, 100.0]) + real(5e-4)  # servo
    )
    tip = (text("finger_tip") + byte(1) + reals([0.0, 0.0, 0.05]) + reals([0.0, 0.0, 0.0, 1.0]) + real(0.0)
           + option(None))
    safety = real(0.1) + uint(reaction) + reals([0.01, 20.0, 28.0])
    return text("finger") + reals([0.0, 0.0, 0.0]) + sequence([tip]) + sequence([joint]) + safety + sequence([]) + option(None)


FINGER = model(2)
LOWEST = struct.unpack("<f", b"\xff\xff\x7f\xff")[0]  # no zero among its bytes


def joints(command, *lists):
    """A command of the joint servo."""
    return TASK + JOINT_SERVO + uint(command) + b"".join(map(sequence, lists))


def goal(positions):
    return joints(0, map(real, positions))


def plan(contacts, clearance, touch_force, friction, internal, force_limit, feedback, control,
         printed=uint(0) * 3):
    """`contacts`: positions and normals; `printed`: object frame, load and joint targets; the others as encoded or as
    numbers."""
    friction = option(None if friction is None else real(friction))
    return (b"".join(reals(position) + reals(normal) for position, normal in contacts) + real(clearance)
            + real(touch_force) + friction + internal + real(force_limit) + boolean(feedback) + control + printed)


def differential(observer):
    return uint(0) + uint(observer)


def by_wrench(position, orientation, damping, compensated):
    return uint(1) + reals(position) + reals(orientation) + real(damping) + boolean(compensated)


PHASES = "ready approach touch squeeze probe-friction hold move lower open".split()
PLAN_FIELDS = "clearance touch-force friction force-limit margin capacity strength gain mass".split()
BOX = [([0.0625, 0.04, 0.125], [1.0, 0.0, -0.5]), ([0.0625, -0.04, 0.125], [1.0, 0.0, -0.5]),
       ([0.125, 0.0, 0.0625], [-2.0, 0.0, 1.0])]
FAILURES = {
    "obstructed": uint(0) + byte(2) + real(0.75),
    "no-object": uint(1) + byte(0) + real(0.02),
    "no-grip": uint(2) + reals([0.25, 3.0]),
    "no-support": uint(3) + real(0.05),
    "out-of-reach": uint(4) + byte(1),
}


def grasp(phase, failure, pose, load, target_forces, friction, slips, overloaded):
    """Report of a grasp to the supervisor. `pose`: position and quaternion."""
    return (GRASPING + uint(phase) + option(failure) + reals(pose) + reals(load)
            + b"".join(map(reals, target_forces)) + real(friction) + uint(slips) + boolean(overloaded))


SENSOR = uint(0)


def observer(bandwidth):
    return uint(1) + real(bandwidth)


FOLLOWING = uint(1)


def direct(friction, driven_term, null_space_damping):
    return uint(0) + real(friction) + boolean(driven_term) + boolean(null_space_damping)


def settings(mass, damping, stiffness, law, redundancy, elbow_bandwidth, force, contact_force, max_deviation,
             axes=0, coupling=None):
    """Settings of impedance control. Six numbers each for the impedance, fifteen each for its coupling."""
    return (reals(mass) + reals(damping) + reals(stiffness) + uint(axes)
            + option(None if coupling is None else b"".join(map(reals, coupling))) + law + redundancy
            + real(elbow_bandwidth) + force + real(contact_force) + reals(max_deviation))


def target(position, rotation, velocity, acceleration, elbow):
    """A command of impedance control: the set-point of tool and elbow."""
    return (TASK + IMPEDANCE + uint(0) + reals(position) + reals(rotation) + reals(velocity)
            + reals(acceleration) + reals(elbow))


def impedance(position, rotation, error, wrench, contact, sigma_min, elbow, derating):
    """Report of impedance control to the supervisor."""
    return (IMPEDANCE + reals(position) + reals(rotation) + reals(error) + reals(wrench) + boolean(contact)
            + reals([sigma_min, elbow, derating]))


def retargeting(follows, weights, numbers, speeds, tolerance, directions, servo, limits):
    """Settings of telexistence. `numbers`: scale, near, far, contact of the operator's tips and the robot's."""
    return (b"".join(map(byte, follows)) + reals(weights) + reals(numbers) + reals(speeds) + real(tolerance)
            + boolean(directions) + uint(servo) + reals(limits))


def fingertips(number, age, tips):
    """A command of telexistence: position, velocity and direction, or none, of each tip that is known."""
    def tip(position, velocity, direction):
        return reals(position) + reals(velocity) + option(None if direction is None else reals(direction))
    return (TASK + TELEXISTENCE + uint(0) + uint(number) + real(age)
            + b"".join(option(None if one is None else tip(*one)) for one in tips))


def reproduced(samples, ignored, age, errors, missed, unknown, limited):
    """Report of telexistence to the supervisor."""
    return (TELEXISTENCE + uint(samples) + uint(ignored) + byte(age) + reals(errors) + byte(missed)
            + byte(unknown) + uint(limited))


def approach(chain, joint, gripper, servo, hand):
    """Settings of the visual approach. `gripper`: open, closed, speed, torque; `hand`: speed, acceleration, contact
    force, reach."""
    return byte(chain) + byte(joint) + reals(gripper) + uint(servo) + reals(hand)


def hand(pose, latched, motion, remaining, force, gripper, opening):
    """Report of the visual approach to the supervisor. Poses: position and quaternion; latched: number and
    pose."""
    kept = None if latched is None else uint(latched[0]) + reals(latched[1])
    return (VISUAL_APPROACH + reals(pose) + option(kept) + uint(motion) + real(remaining) + reals(force)
            + uint(gripper) + real(opening))


LEAST_MOTION, ARM_ANGLE = uint(0), uint(2)
YIELDING = [[1.5] * 3 + [0.0625] * 3, [7.5] * 3 + [0.5] * 3, [300.0] * 3 + [8.0] * 3]
SETPOINT_ERRORS = {
    "distance": uint(0) + reals([1.0, 0.25]),
    "rotation": uint(1) + reals([3.125, 1.5]),
    "not-finite": uint(2),
    "not-unit": uint(3) + real(0.5),
    "elbow": uint(4) + reals([2.0, 1.5]),
}
INVALID_SETTINGS = {
    "impedance-mass": uint(0) + uint(0) + byte(4) + reals([0.0, 10000.0]),
    "impedance-damping": uint(0) + uint(1) + byte(0) + reals([-1.0, 150.0]),
    "impedance-stiffness": uint(0) + uint(2) + byte(5) + reals([4000.0, 3750.0]),
    "joint": uint(1) + byte(7) + byte(7),
    "no-arm-angle": uint(2),
    "elbow-bandwidth": uint(3) + reals([60.0, 50.0]),
    "contact-force": uint(4) + real(-1.0),
    "max-deviation": uint(5) + real(0.0),
    "force-bandwidth": uint(6) + reals([60.0, 50.0]),
    "no-redundant-joint": uint(7),
    "friction": uint(8) + real(1.5),
    "impedance-mass-matrix": uint(0) + uint(3) + byte(1) + reals([-1.0, 0.5]),
    "impedance-damping-matrix": uint(0) + uint(4) + byte(1) + reals([-1.0, 0.0]),
    "impedance-stiffness-matrix": uint(0) + uint(5) + byte(1) + reals([-1.0, 0.0]),
    "impedance-damping-to-mass": uint(0) + uint(6) + byte(3) + reals([-1.0, 0.0]),
    "impedance-stiffness-to-mass": uint(0) + uint(7) + byte(3) + reals([-1.0, 0.0]),
    "mass-in-contact": uint(9) + byte(2) + reals([0.5, 4.0, 1.0]),
}
LIMITS = {
    "joint-count": uint(0) + byte(2) + byte(9),
    "not-finite": uint(1) + byte(15),
    "outside-limits": uint(2) + byte(0) + reals([2.0, -1.5, 1.5]),
    "too-fast": uint(3) + byte(1) + reals([9.0, 8.0]),
    "jump": uint(4) + byte(2) + reals([0.5, 0.25]),
    "too-much-acceleration": uint(5) + byte(3) + reals([9000.0, 2857.0]),
    "too-much-torque": uint(6) + byte(3) + reals([0.75, 0.6]),
}
JOINT_SERVO_REFUSALS = {
    "limit": uint(0) + LIMITS["outside-limits"],
    "tip-count": uint(1) + byte(1) + byte(3),
    "not-a-finger": uint(2) + byte(2),
    "out-of-reach": uint(3) + byte(1) + reals([0.1, 0.0, -0.25]),
    "singular": uint(4) + byte(0),
    "tip-not-finite": uint(5) + byte(2),
}
GRASP_REFUSALS = {
    "not-a-hand": uint(0),
    "not-tared": uint(1) + byte(1),
    "plan-contact": uint(3) + uint(1) + byte(2),
    "plan-no-triangle": uint(3) + uint(2),
    "plan-cannot-grip": uint(3) + uint(3),
    "plan-unbalanced": uint(3) + uint(4) + real(0.25),
    "out-of-reach": uint(4) + byte(1) + reals([0.1, 0.0, -0.25]),
    "not-finite": uint(5),
    "too-fast": uint(6) + reals([0.375, 0.2]),
    "limit": uint(7) + LIMITS["outside-limits"],
}
for number, name in enumerate(PHASES):
    GRASP_REFUSALS["busy-" + name] = uint(2) + uint(number)
for number, name in enumerate(PLAN_FIELDS):
    GRASP_REFUSALS["plan-" + name] = uint(3) + uint(0) + uint(number) + reals([2.0, 0.25, 1.0])
IMPEDANCE_REFUSALS = {
    "not-an-arm": uint(0),
    "not-tared": uint(1) + byte(0),
    "no-force-sensor": uint(2),
    "force-source-in-use": uint(3),
}
for name, invalid in INVALID_SETTINGS.items():
    IMPEDANCE_REFUSALS["settings-" + name] = uint(4) + invalid
for name, error in SETPOINT_ERRORS.items():
    IMPEDANCE_REFUSALS["setpoint-" + name] = uint(5) + error

RETARGET_FIELDS = """fingers follows weights scale near far operator-contact robot-contact speeds
tolerance""".split()
TELEXISTENCE_REFUSALS = {"not-a-hand": uint(0)}
for number, name in enumerate(RETARGET_FIELDS):
    TELEXISTENCE_REFUSALS["settings-" + name] = uint(1) + uint(0) + uint(number) + reals([2.0, 0.25, 1.0])
TELEXISTENCE_REFUSALS["settings-acceleration"] = uint(1) + uint(1) + real(0.5)
TELEXISTENCE_REFUSALS["settings-max-sample-age"] = uint(1) + uint(2) + real(3.0)
TELEXISTENCE_REFUSALS["fingertip"] = uint(2) + byte(4)
TELEXISTENCE_REFUSALS["age"] = uint(3) + real(1.5)

NO_GRASP = [[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], [0.0] * 6, [[0.0] * 3] * 3, 0.0, 0, False]

# Fields of the visual approach's settings, in the order of their numbers.
APPROACH_FIELDS = ["speed", "acceleration", "contact-force", "reach", "gripper-range", "gripper-speed",
                   "gripper-torque"]
VISUAL_APPROACH_REFUSALS = {"no-chain": uint(0) + byte(3), "no-gripper": uint(1) + byte(2)}
for name, limit in LIMITS.items():
    VISUAL_APPROACH_REFUSALS["limit-" + name] = uint(2) + limit
for number, name in enumerate(APPROACH_FIELDS):
    VISUAL_APPROACH_REFUSALS[name] = uint(3) + uint(number) + reals([2.0, 0.25, 1.0])
VISUAL_APPROACH_REFUSALS["target"] = uint(4) + reals([0.75, 0.5])
VISUAL_APPROACH_REFUSALS["too-fast"] = uint(5) + reals([0.25, 0.125])
VISUAL_APPROACH_REFUSALS["blocked"] = uint(6) + real(0.03125)
VISUAL_APPROACH_REFUSALS["gripper-axis"] = uint(7) + byte(6) + reals([0.0625, 0.0078125])
VISUAL_APPROACH_REFUSALS["singular"] = uint(8) + byte(3)
