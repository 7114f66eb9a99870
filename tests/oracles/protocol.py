#!/usr/bin/env python3
"""Golden frames: every message of docs/protocol.md, by hand-made COBS and postcard and zlib's CRC-32."""

import zlib

from data_file import write
from protocol_encoding import (
    blob, boolean, byte, frame, option, real, reals, sequence, uint,
)
from protocol_parts import (
    ARM_ANGLE, BOX, CLEAR_FAULTS, CLIENT, DISABLE, DISABLED, ENABLE, EXPORT, FAILURES, FAULT, FINGER,
    FIRMWARE, FOLLOWING, GRASPING, GRASP_REFUSALS, HELLO, HOME, IDENTITY, IMPEDANCE, IMPEDANCE_REFUSALS, JOINT_SERVO,
    JOINT_SERVO_REFUSALS, KEEP, LEAST_MOTION, LIMITS, LOWEST, MODEL_BEGIN, MODEL_CHUNK, MODEL_COMMIT,
    NO_GRASP, NO_STATISTICS, PHASES, QUIET_BOARD, READ_EXPORT, READ_FAULTS, READ_STATUS, READ_TASK,
    RELEASE_COMMAND, SCHEMA, SENSOR, SET_RATE, STATE, STOP, TAKE_COMMAND, TARE, TASK, TASKS, TELEXISTENCE,
    TELEXISTENCE_REFUSALS, VISUAL_APPROACH, VISUAL_APPROACH_REFUSALS, YIELDING, actuators, approach, board_status, by_wrench, differential, direct, enabled, fault,
    fingertips, frame_counts, goal, grasp, hand, impedance, joints, model, node_status, observer, plan, reply,
    reproduced, request, retargeting, sensors, settings, target, telemetry,
)

COLUMNS = """
Lines: name of the message, bytes of its frame in hexadecimal (of a model: those that a push carries).
The units of the numbers in them are those of docs/protocol.md.
"""

LINES = []


def golden(name, message):
    LINES.append((name, frame(message)))


# ---- the session of the page -------------------------------------------------------------------------------


def session():
    crc = zlib.crc32(FINGER)

    def step(number, name, what, answer, tick):
        golden("request-session-" + name, request(number, what))
        golden("board-session-" + name, reply(number, tick, answer))

    done = uint(1)
    golden("sensors-session-1", sensors(1, 0, 24000, [1000], [0]))
    golden("actuators-session-1", actuators(1, False, []))
    step(1, "hello", HELLO + uint(SCHEMA), uint(0) + uint(SCHEMA) + IDENTITY, 1)
    step(2, "take-command", TAKE_COMMAND + boolean(False), done, 1)
    step(3, "model-begin", MODEL_BEGIN + uint(len(FINGER)) + uint(crc), done, 1)
    step(4, "model-chunk-0", MODEL_CHUNK + uint(0) + blob(FINGER[:192]), done, 1)
    step(5, "model-chunk-192", MODEL_CHUNK + uint(192) + blob(FINGER[192:]), done, 1)
    step(6, "model-commit", MODEL_COMMIT, done, 1)
    golden("sensors-session-2", sensors(2, 0, 24000, [1000], [0]))
    golden("actuators-session-2", actuators(2, False, [0.0]))
    step(7, "home", HOME + sequence([real(0.0)]), done, 2)
    step(8, "set-rate", SET_RATE + uint(0) + uint(1), done, 2)
    step(9, "enable", ENABLE + JOINT_SERVO + uint(1), done, 2)
    golden("sensors-session-3", sensors(3, 0, 24000, [1000], [0]))
    golden("actuators-session-3", actuators(3, True, [0.0]))
    golden("board-session-telemetry", uint(1) + telemetry(3, enabled(JOINT_SERVO), 0, [[0.0, 0.0, 0.0, 0.0]]))
    step(10, "goal", goal([0.5]), done, 3)
    outside = uint(19) + JOINT_SERVO + uint(0) + uint(2) + byte(0) + reals([2.0, -1.5, 1.5])
    step(11, "goal-outside", goal([2.0]), uint(2) + outside, 3)
    step(12, "disable", DISABLE, done, 3)
    status = node_status(DISABLED, "finger", crc, 1, 0, True, CLIENT, 3, 24.0) + QUIET_BOARD
    step(13, "read-status", READ_STATUS, uint(3) + status, 3)
    step(14, "release-command", RELEASE_COMMAND, done, 3)


# ---- one of each -------------------------------------------------------------------------------------------


def requests():
    each = {
        "hello": HELLO + uint(SCHEMA),
        "hello-0": HELLO + uint(0),
        "disable": DISABLE,
        "stop": STOP,
        "take-command": TAKE_COMMAND + boolean(False),
        "take-command-by-force": TAKE_COMMAND + boolean(True),
        "release-command": RELEASE_COMMAND,
        "model-begin": MODEL_BEGIN + uint(4096) + uint(0xDEADBEEF),
        "model-chunk": MODEL_CHUNK + uint(192) + blob([0, 1, 254, 255]),
        "model-chunk-long": MODEL_CHUNK + uint(3840) + blob([255] * 192),
        "model-chunk-zeros": MODEL_CHUNK + uint(0) + blob([0] * 192),
        "model-commit": MODEL_COMMIT,
        "home": HOME + sequence(map(real, [0.25, -1.5])),
        "home-none": HOME + sequence([]),
        "tare": TARE,
        "keep": KEEP,
        "read-task": READ_TASK,
        "read-status": READ_STATUS,
        "read-faults": READ_FAULTS,
        "clear-faults": CLEAR_FAULTS + uint(300),
        "set-rate-telemetry": SET_RATE + uint(0) + uint(1),
        "set-rate-status": SET_RATE + uint(1) + uint(100),
        "set-rate-log": SET_RATE + uint(2) + uint(65535),
        "set-rate-tips": SET_RATE + uint(3) + uint(2),
        "set-rate-task": SET_RATE + uint(4) + uint(5),
        "export-model": EXPORT + uint(0),
        "export-state": EXPORT + uint(1),
        "read-export": READ_EXPORT + uint(192),
    }
    for name, what in {**each, **joint_servo(), **grasping(), **impedance_control(), **telexistence(),
                       **visual_approach()}.items():
        golden("request-" + name, request(9, what))
    golden("request-first-number", request(0, READ_STATUS, client=1))
    golden("request-last-number", request(65535, READ_STATUS, client=0xFFFFFFFF))


def joint_servo():
    points = [[0.5, -0.25, 2.0], [0.0, 0.0, 0.0]]
    tip = [0.1, -0.04, 0.0625, 0.5, -0.25, 0.125, 2.0, -1.0, 0.0]
    return {
        "enable-pid": ENABLE + JOINT_SERVO + uint(0),
        "enable-observer": ENABLE + JOINT_SERVO + uint(1),
        "enable-bare-pid": ENABLE + JOINT_SERVO + uint(2),
        "joints-goal": goal([0.5, -0.25, 0.125]),
        "joints-stream": joints(1, map(reals, points)),
        "joints-stream-16": joints(1, [reals([LOWEST] * 3)] * 16),
        "joints-stream-tips": joints(2, [reals(tip), reals([0.0] * 9)]),
        "joints-stream-tips-6": joints(2, [reals([LOWEST] * 9)] * 6),
        "joints-stream-torques": joints(3, map(reals, points), map(real, [0.125, -0.0625])),
        "joints-stream-torques-16": joints(3, [reals([LOWEST] * 3)] * 16, [real(LOWEST)] * 16),
    }


def grasping():
    command = TASK + GRASPING
    least_grip, normal = uint(0) + reals([0.2, 0.3, 1.0]), uint(1) + real(2.0)
    pairwise = uint(2) + reals([0.5, 1.0, 1.5])
    by_gains = by_wrench([150.0, 300.0], [0.5, 1.0], 0.03125, False)
    lowest = ([LOWEST] * 3, [LOWEST] * 3)
    longest = by_wrench([LOWEST] * 2, [LOWEST] * 2, LOWEST, True)
    return {
        "enable-grasping": ENABLE + GRASPING,
        "grasp": command + uint(0) + plan(BOX, 0.01, 0.1, None, least_grip, 9.0, True, differential(1)),
        "grasp-normal": command + uint(0) + plan(BOX, 0.005, 0.125, 0.5, normal, 4.0, False, differential(0)),
        "grasp-pairwise": command + uint(0) + plan(BOX, 0.01, 0.1, 0.75, pairwise, 9.0, True, by_gains,
                                                    uint(1) + uint(1) + real(0.5) + uint(1)),
        "grasp-longest": command + uint(0)
        + plan([lowest] * 3, LOWEST, LOWEST, LOWEST, uint(2) + reals([LOWEST] * 3), LOWEST, True, longest,
               uint(1) + uint(1) + real(LOWEST) + uint(1)),
        "grasp-move": command + uint(1) + reals([0.0, 0.0, 0.02]) + reals([0.25, -0.125, 0.0]) + real(1.5),
        "grasp-put-down": command + uint(2),
        "grasp-open": command + uint(3),
    }


def impedance_control():
    rest = 12.0, SENSOR, 1.5, [0.25, 1.5]
    yielding = settings(*YIELDING, FOLLOWING, ARM_ANGLE, *rest)
    printed = settings(*YIELDING, direct(0.75, False, True), LEAST_MOTION, *rest)
    driven = settings(*YIELDING, FOLLOWING, uint(1) + byte(2), *rest)
    observed = settings(*YIELDING, FOLLOWING, ARM_ANGLE, 12.0, observer(30.0), 1.5, [0.25, 1.5])
    coupling = [0.25] + [0.0] * 14, [0.0] * 14 + [0.125], [0.0, -100.0] + [0.0] * 13
    coupled = settings(*YIELDING, FOLLOWING, ARM_ANGLE, *rest, axes=1, coupling=coupling)
    lowest = [LOWEST] * 6
    longest = settings(lowest, lowest, lowest, direct(LOWEST, True, True), uint(1) + byte(255), LOWEST,
                       observer(LOWEST), LOWEST, lowest[:2], axes=1, coupling=[[LOWEST] * 15] * 3)
    enable, configure = ENABLE + IMPEDANCE, TASK + IMPEDANCE + uint(1)
    position, rotation = [0.5, 0.0, -0.25], [0.0, 0.0, 0.0, 1.0]
    velocity = [0.125, 0.0, 0.0, 0.0, 0.0, 0.5]
    return {
        "enable-impedance": enable + yielding,
        "enable-impedance-direct": enable + printed,
        "enable-impedance-driven": enable + driven,
        "enable-impedance-observed": enable + observed,
        "enable-impedance-coupled": enable + coupled,
        "enable-impedance-longest": enable + longest,
        "impedance-configure": configure + yielding,
        "impedance-configure-direct": configure + printed,
        "impedance-configure-driven": configure + driven,
        "impedance-configure-observed": configure + observed,
        "impedance-configure-coupled": configure + coupled,
        "impedance-configure-longest": configure + longest,
        "impedance-target": target(position, rotation, velocity, [0.0] * 6, [0.25, 0.0, 0.0]),
        "impedance-target-longest": target(lowest[:3], lowest[:4], lowest, lowest, lowest[:3]),
    }


def telexistence():
    five = retargeting(range(5), [1.0] * 5, [1.25, 0.0078125, 0.03125, 0.015625, 0.0], [4.0] * 16,
                       0.0009765625, True, 1, [64.0, 0.25])
    longest = retargeting([255] * 5, [LOWEST] * 5, [LOWEST] * 5, [LOWEST] * 16, LOWEST, True, 1, [LOWEST] * 2)
    thumb = [0.0625, -0.125, 0.0], [0.0, 0.5, 0.0], [1.0, 0.0, 0.0]
    index = [0.125, 0.0, 0.0625], [0.0] * 3, None
    return {
        "enable-telexistence": ENABLE + TELEXISTENCE + five,
        "enable-telexistence-longest": ENABLE + TELEXISTENCE + longest,
        "telexistence-follow": fingertips(300, 0.03125, [thumb, index, None, None, None]),
        "telexistence-follow-longest": fingertips(65535, LOWEST, [[[LOWEST] * 3] * 3] * 5),
        "telexistence-release": TASK + TELEXISTENCE + uint(1),
    }


def visual_approach():
    knob = approach(0, 6, [-0.75, 0.25, 2.0, 0.5], 0, [0.125, 0.5, 20.0, 0.5])
    longest = approach(255, 255, [LOWEST] * 4, 1, [LOWEST] * 4)
    command = TASK + VISUAL_APPROACH
    return {
        "enable-visual-approach": ENABLE + VISUAL_APPROACH + knob,
        "enable-visual-approach-longest": ENABLE + VISUAL_APPROACH + longest,
        "visual-approach-latch": command + uint(0) + uint(300),
        "visual-approach-latch-longest": command + uint(0) + uint(65535),
        "visual-approach-move": command + uint(1) + reals([0.75, -0.0625, 0.125, 0.0625]),
        "visual-approach-move-longest": command + uint(1) + reals([LOWEST] * 4),
        "visual-approach-stand": command + uint(2),
        "visual-approach-open": command + uint(3),
        "visual-approach-close": command + uint(4),
        "visual-approach-acknowledge": command + uint(5),
    }


FIELDS = """joints chains gravity name origin-translation origin-rotation axis mass center-of-mass inertia
rotor-inertia torque-constant current-limit current-resolution motor-bandwidth motor-delay coulomb viscous
counts-per-turn limit-lower limit-upper limit-velocity limit-torque limit-torque-rate limit-following-error
filter-time proportional integral derivative cutoff servo-inertia bandwidth observer-bandwidth command-timeout
damping supply-min supply-max rest-error
chain-name tip-translation tip-rotation force-resolution torque-resolution saturation force-limit tip-mass
tip-center-of-mass tip-radius mimic-joint mimic-multiplier mimic-offset mimic-force-sensor encoder-relative
motor-resistance motor-inductance mimic-chain mimic-place gauges calibration-matrix gauge-range gauge-gains""".split()


def refusals():
    def error(joint, field, value, problem):
        return uint(7) + option(None if joint is None else byte(joint)) + uint(field) + real(value) + problem

    each = {
        "schema-mismatch": uint(0) + uint(SCHEMA) + FIRMWARE,
        "wrong-mode-disabled": uint(1) + DISABLED,
        "wrong-mode-fault": uint(1) + FAULT,
        "commanded": uint(2) + uint(0xDECADE),
        "not-commander": uint(3),
        "stale": uint(4) + uint(12),
        "faults-unread": uint(5) + uint(3),
        "no-model": uint(6),
        "model-not-finite": error(None, 2, float("inf"), uint(0)),
        "model-below": error(3, 7, -0.5, uint(1) + real(0.0)),
        "model-not-above": error(15, 20, 1.0, uint(2) + real(1.0)),
        "model-above": error(0, 15, 0.5, uint(3) + real(0.01)),
        "model-not-unit": error(1, 6, 0.5, uint(4)),
        "model-not-physical": error(2, 9, -0.125, uint(5)),
        "model-count": error(None, 1, 8.0, uint(6) + real(9.0)),
        "model-not-unique": error(4, 3, 4.0, uint(7)),
        "model-no-such-joint": error(8, 48, 7.0, uint(8)),
        "model-not-supported": error(8, 49, 0.0, uint(9)),
        "model-board-limit": error(3, 0, 9.0, uint(10) + real(3.0)),
        "model-missing": error(2, 53, 0.0, uint(11)),
        "model-singular": error(2, 58, 0.001, uint(12)),
        "model-transfer": uint(8) + uint(192) + uint(220),
        "model-checksum": uint(9) + uint(0x01020304) + uint(0xDEADBEEF),
        "model-unreadable": uint(10) + uint(5000) + uint(4096),
        "no-sensors": uint(11),
        "unsafe": uint(12) + fault(10, None, 12.0, 20.0, 1234),
        "not-homed": uint(13) + byte(8),
        "no-force-sensor": uint(14),
        "not-exported": uint(15) + uint(0),
        "no-task": uint(17),
    }
    for name, task in TASKS.items():
        each["wrong-mode-" + name] = uint(1) + enabled(task)
        each["other-task-" + name] = uint(18) + task
    for name, limit in LIMITS.items():
        each["limit-" + name] = uint(16) + limit
    for name, refusal in JOINT_SERVO_REFUSALS.items():
        each["joint-servo-" + name] = uint(19) + JOINT_SERVO + refusal
    for name, refusal in GRASP_REFUSALS.items():
        each["grasping-" + name] = uint(19) + GRASPING + refusal
    for name, refusal in IMPEDANCE_REFUSALS.items():
        each["impedance-" + name] = uint(19) + IMPEDANCE + refusal
    for name, refusal in TELEXISTENCE_REFUSALS.items():
        each["telexistence-" + name] = uint(19) + TELEXISTENCE + refusal
    for name, refusal in VISUAL_APPROACH_REFUSALS.items():
        each["visual-approach-" + name] = uint(19) + VISUAL_APPROACH + refusal
    for name, what in each.items():
        golden("board-refused-" + name, reply(9, 1234, uint(2) + what))
    for number, name in enumerate(FIELDS):
        golden("board-refused-field-" + name, reply(9, 1234, uint(2) + error(7, number, 0.5, uint(0))))


def from_board():
    crystal_fault = node_status(FAULT, "hand3", 0x89ABCDEF, 511, 18, False, 0xDECADE, 100000, 23.5)
    nobody = node_status(DISABLED, "", 0, 0, 0, True, None, 0, 0.0)
    full = board_status(1, 2, "panicked at src/main.rs:7", 2048, 16384,
                        frame_counts(1, 2, 3, 4, 5) + uint(6) + uint(7) + uint(8),
                        frame_counts(128, 0, 0, 16384, 0) + uint(0) + uint(0) + uint(4294967295))
    statuses = {
        "nothing": nobody + QUIET_BOARD,
        "fault": crystal_fault + full,
        "watchdog": nobody + board_status(2, 1, "", 0, 0, NO_STATISTICS, NO_STATISTICS),
        "hard-fault": nobody + board_status(0, 3, "w" * 96, 0, 0, NO_STATISTICS, NO_STATISTICS),
        "software": nobody + board_status(0, 4, "", 0, 0, NO_STATISTICS, NO_STATISTICS),
        "crystal-stopped": nobody + board_status(1, 5, "", 0, 0, NO_STATISTICS, NO_STATISTICS),
        "brown-out": nobody + board_status(0, 6, "", 0, 0, NO_STATISTICS, NO_STATISTICS),
    }
    golden("board-hello", reply(9, 1234, uint(0) + uint(SCHEMA) + IDENTITY))
    golden("board-done", reply(9, 1234, uint(1)))
    golden("board-done-first-number", reply(0, 0, uint(1), client=1))
    golden("board-done-last-number", reply(65535, 4294967295, uint(1), client=0xFFFFFFFF))
    for name, status in statuses.items():
        golden("board-status-" + name, reply(9, 1234, uint(3) + status))
    golden("board-faults-none", reply(9, 1234, uint(4) + uint(0) + sequence([])))
    first = [fault(cause, cause if cause % 2 else None, cause + 0.5, 0.25, 100 + cause)
             for cause in range(16)]
    golden("board-faults-0-to-15", reply(9, 1234, uint(4) + uint(16) + sequence(first)))
    second = [fault(cause, None, 2.0, 0.0, 0) for cause in range(16, 32)]
    golden("board-faults-16-to-31", reply(9, 1234, uint(4) + uint(4294967295) + sequence(second)))
    golden("board-faults-32", reply(9, 1234, uint(4) + uint(33) + sequence([fault(32, 5, 3.0, 0.0, 70)])))
    at_boot = [fault(33, None, 1.0, 0.0, 0), fault(34, None, 0.0, 3.0, 0)]
    golden("board-faults-33-and-34", reply(9, 1234, uint(4) + uint(35) + sequence(at_boot)))
    exported = uint(5) + uint(220) + uint(0xDEADBEEF) + uint(2469) + uint(STATE)
    golden("board-exported", reply(9, 1234, exported))
    golden("board-chunk", reply(9, 1234, uint(6) + uint(192) + blob([0, 1, 254, 255])))
    golden("board-chunk-long", reply(9, 1234, uint(6) + uint(0) + blob(range(192))))
    streams()
    golden("board-stream-status", uint(2) + statuses["fault"])
    for number, (name, record) in enumerate(RECORDS.items()):
        golden("board-log-" + name, uint(3) + uint(2468 + number) + record)
    golden("board-log-longest", uint(3) + uint(4294967295) + uint(1) + FULL_SENSORS)


def streams():
    def task(tick, what):
        return uint(tick) + what

    two = [[0.5, -0.25, 0.5625, 0.03125], [-0.5, 0.25, -0.5625, -0.03125]]
    golden("board-telemetry-none", uint(1) + telemetry(0, DISABLED, 0, []))
    golden("board-telemetry-joint-servo", uint(1) + telemetry(1234, enabled(JOINT_SERVO), 0, two))
    golden("board-telemetry-grasping", uint(1) + telemetry(1235, enabled(GRASPING), 0, two[:1]))
    golden("board-telemetry-impedance", uint(1) + telemetry(1236, enabled(IMPEDANCE), 0, two[:1]))
    golden("board-telemetry-telexistence", uint(1) + telemetry(1237, enabled(TELEXISTENCE), 0, two[:1]))
    golden("board-telemetry-16", uint(1) + telemetry(4294967295, FAULT, 4294967295, [[LOWEST] * 4] * 16))
    tip = reals([0.1, -0.04, 0.0625, 1.5, 0.0, -0.5, 0.0, 0.015625, 0.0]) + boolean(True)
    golden("board-tips", uint(4) + uint(1234) + sequence([tip, reals([0.0] * 9) + boolean(False)]))
    golden("board-tips-6", uint(4) + uint(4294967295) + sequence([reals([LOWEST] * 9) + boolean(True)] * 6))

    golden("board-task-joint-servo", uint(5) + task(1234, JOINT_SERVO))
    golden("board-read-task-joint-servo", reply(9, 1234, uint(7) + task(1234, JOINT_SERVO)))

    holding = [[0.09, 0.0, 0.0625, 0.0, 0.375, 0.0, 0.927], [0.5, 0.0, 1.75, 0.0, -0.015625, 0.0],
               [[1.0, 0.0, 0.5], [1.0, 0.0, 0.5], [-1.5, 0.0, 0.75]], 0.4375]
    golden("board-task-grasping", uint(5) + task(1234, grasp(5, None, *holding, 300, False)))
    forces = [[LOWEST] * 3] * 3
    longest = grasp(8, FAILURES["no-grip"], [LOWEST] * 7, [LOWEST] * 6, forces, LOWEST, 65535, True)
    golden("board-task-grasping-longest", uint(5) + task(4294967295, longest))
    golden("board-read-task-grasping", reply(9, 1234, uint(7) + task(1234, grasp(0, None, *NO_GRASP))))
    for number, name in enumerate(PHASES):
        report = task(1233, grasp(number, None, *holding, 0, True))
        golden("board-read-task-grasping-" + name, reply(9, 1234, uint(7) + report))
    for name, failure in FAILURES.items():
        report = task(1234, grasp(0, failure, *NO_GRASP))
        golden("board-read-task-grasping-" + name, reply(9, 1234, uint(7) + report))

    pushed = [[0.5, 0.0, -0.25], [0.0, 0.0, 0.0, 1.0], [0.0625, 0.0, 0.0, 0.0, 0.0, -0.125],
              [18.75, 0.0, 0.0, 0.0, 0.0, -1.0], True, 0.15625, 0.25, 1.5]
    golden("board-task-impedance", uint(5) + task(1234, impedance(*pushed)))
    longest = impedance([LOWEST] * 3, [LOWEST] * 4, [LOWEST] * 6, [LOWEST] * 6, True, LOWEST, LOWEST, LOWEST)
    golden("board-task-impedance-longest", uint(5) + task(4294967295, longest))
    golden("board-read-task-impedance", reply(9, 1234, uint(7) + task(1234, impedance(*pushed))))

    telexist = reproduced(300, 2, 1, [0.0, 0.001953125, 0.0, 0.0, 0.0], 2, 28, 32)
    golden("board-task-telexistence", uint(5) + task(1234, telexist))
    longest = reproduced(4294967295, 4294967295, 255, [LOWEST] * 5, 255, 255, 65535)
    golden("board-task-telexistence-longest", uint(5) + task(4294967295, longest))
    golden("board-read-task-telexistence", reply(9, 1234, uint(7) + task(1234, telexist)))

    place, level = [0.75, 0.0, 0.125], [0.0, 0.5, 0.0, 0.5]
    for number, name in enumerate(["standing", "moving", "blocked", "limited"]):
        moves = hand(place + level, None, number, 0.0625, [1.0, 0.0, -2.0], 2, -0.75)
        golden("board-task-visual-approach-" + name, uint(5) + task(1234, moves))
    for number, name in enumerate(["still", "opening", "open", "closing", "holding", "empty", "jammed"]):
        grips = hand(place + level, (300, place + level), 0, 0.0, [0.0] * 3, number, 0.25)
        golden("board-task-visual-approach-" + name, uint(5) + task(1234, grips))
    longest = hand([LOWEST] * 7, (65535, [LOWEST] * 7), 3, LOWEST, [LOWEST] * 3, 5, LOWEST)
    golden("board-task-visual-approach-longest", uint(5) + task(4294967295, longest))
    golden("board-read-task-visual-approach", reply(9, 1234, uint(7) + task(1234, grips)))


FULL_SENSORS = sensors(4294967295, 255, 65535, [-2147483648] * 16, [-32768] * 16, [[-2147483648] * 6] * 6)
RECORDS = {
    "request": uint(0) + request(9, DISABLE),
    "sensors": uint(1) + sensors(1234, 1, 24000, [100, -100], [5, -5]),
    "actuators": uint(2) + actuators(1234, True, [0.25, -0.25]),
    "start": uint(3) + uint(SCHEMA) + IDENTITY + uint(1795000000),
    "state": uint(4) + uint(192) + blob([0, 1, 254, 255]),
    "restore": uint(5) + uint(196) + uint(0xDEADBEEF) + uint(STATE),
    "gap": uint(6) + uint(300),
    "end": uint(7) + uint(70000),
}


def plant_link():
    golden("sensors", sensors(1234, 0, 24000, [100, -100, 0], [5, -5, 0]))
    golden("sensors-none", sensors(0, 0, 0, [], []))
    golden("sensors-emergency-stop", sensors(300, 1, 65535, [-2147483648, 2147483647], [-32768, 32767]))
    golden("sensors-16", FULL_SENSORS)
    forces = [[1000, -1000, 0, 7, -7, 63], [0, 0, 0, 0, 0, 1]]
    golden("sensors-forces", sensors(1234, 0, 24000, [100], [5], forces))
    golden("actuators-off", actuators(1234, False, [0.0, 0.0, 0.0]))
    golden("actuators-on", actuators(300, True, [0.0, -0.25, 0.5]))
    golden("actuators-none", actuators(0, False, []))
    golden("actuators-16", actuators(4294967295, True, [LOWEST] * 16))


if __name__ == "__main__":
    requests()
    refusals()
    from_board()
    plant_link()
    for name, record in RECORDS.items():
        golden("record-" + name, record)
    session()
    for number, name in enumerate(["off", "damp", "hold"]):
        LINES.append(("model-" + name, model(number)))
    lines = [f"{name}: {data.hex(' ')}" for name, data in LINES]
    assert len({name for name, _ in LINES}) == len(LINES)
    write("protocol_frames.in", __file__, COLUMNS, "\n".join(lines) + "\n", comment="#")
