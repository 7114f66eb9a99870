#!/usr/bin/env python3
"""Golden frames: every message of docs/protocol.md, written by hand-made COBS and postcard and by zlib's CRC-32."""

import zlib

from data_file import write
from protocol_encoding import (
    blob, boolean, byte, frame, option, real, reals, sequence, uint,
)
from protocol_parts import (
    ARMED_GRASP, ARMED_IMPEDANCE, ARMED_OBSERVER, ARMED_PID, ARM_ANGLE, ARM_ERRORS, BAD_SETTINGS, BOX, CLIENT,
    DISARMED, FAILURES, FAULT, FINGER, FIRMWARE, IDENTITY, LEAST_MOTION, LOWEST, NO_GRASP, NO_STATISTICS,
    PHASES, PLAN_FIELDS, QUIET_BOARD, SCHEMA, SENSOR, TASK, YIELDING, actuators, arm, board_status, by_wrench,
    differential, fault, frame_counts, goal, grasp, guide, model, node_status, observer, plan, pose, reply,
    request, sensors, settings, telemetry,
)

COLUMNS = """
Lines: name of the message, bytes of its frame in hexadecimal (of a model: those that a push carries).
The units of the numbers in them are those of docs/protocol.md.
"""

LINES = []


def golden(name, message):
    LINES.append((name, frame(message)))


# ---- the session of the page ----------------------------------------------------------------------------------------


def session():
    crc = zlib.crc32(FINGER)

    def step(number, name, what, answer, tick):
        golden("request-session-" + name, request(number, what))
        golden("board-session-" + name, reply(number, tick, answer))

    done = uint(1)
    golden("sensors-session-1", sensors(1, 0, 24000, [1000], [0]))
    golden("actuators-session-1", actuators(1, False, []))
    step(1, "hello", uint(0) + uint(SCHEMA), uint(0) + uint(SCHEMA) + IDENTITY, 1)
    step(2, "take-command", uint(13) + boolean(False), done, 1)
    step(3, "model-begin", uint(1) + uint(len(FINGER)) + uint(crc), done, 1)
    step(4, "model-chunk-0", uint(2) + uint(0) + blob(FINGER[:192]), done, 1)
    step(5, "model-chunk-192", uint(2) + uint(192) + blob(FINGER[192:]), done, 1)
    step(6, "model-commit", uint(3), done, 1)
    golden("sensors-session-2", sensors(2, 0, 24000, [1000], [0]))
    golden("actuators-session-2", actuators(2, False, [0.0]))
    step(7, "home", uint(4) + sequence([real(0.0)]), done, 2)
    step(8, "set-rate", uint(12) + uint(0) + uint(1), done, 2)
    step(9, "arm", uint(5) + TASK["observer"], done, 2)
    golden("sensors-session-3", sensors(3, 0, 24000, [1000], [0]))
    golden("actuators-session-3", actuators(3, True, [0.0]))
    golden("board-session-telemetry", uint(1) + telemetry(3, ARMED_OBSERVER, 0, [[0.0, 0.0, 0.0, 0.0]]))
    step(10, "goal", goal([0.5]), done, 3)
    step(11, "goal-outside", goal([2.0]), uint(2) + uint(11) + byte(0) + reals([2.0, -1.5, 1.5]), 3)
    step(12, "disarm", uint(6), done, 3)
    status = node_status(DISARMED, "finger", crc, 1, 0, True, CLIENT, 3, 24.0) + QUIET_BOARD
    step(13, "read-status", uint(9), uint(3) + status, 3)
    step(14, "release-command", uint(14), done, 3)


# ---- one of each ----------------------------------------------------------------------------------------------------


def requests():
    each = {
        "hello": uint(0) + uint(SCHEMA),
        "hello-0": uint(0) + uint(0),
        "model-begin": uint(1) + uint(4096) + uint(0xDEADBEEF),
        "model-chunk": uint(2) + uint(192) + blob([0, 1, 254, 255]),
        "model-chunk-long": uint(2) + uint(3840) + blob([255] * 192),
        "model-chunk-zeros": uint(2) + uint(0) + blob([0] * 192),
        "model-commit": uint(3),
        "home": uint(4) + sequence(map(real, [0.25, -1.5])),
        "home-none": uint(4) + sequence([]),
        "arm-pid": uint(5) + TASK["pid"],
        "arm-observer": uint(5) + TASK["observer"],
        "arm-grasp": uint(5) + TASK["grasp"],
        "arm-impedance": uint(5) + TASK["impedance"],
        "disarm": uint(6),
        "set-point-goal": goal([0.5, -0.25, 0.125]),
        "set-point-stream": uint(7) + uint(1) + sequence(map(reals, [[0.5, -0.25, 2.0], [0.0, 0.0, 0.0]])),
        "set-point-stream-16": uint(7) + uint(1) + sequence([reals([LOWEST] * 3)] * 16),
        "set-point-reach": uint(7) + uint(2)
        + sequence([reals([0.1, -0.04, 0.0625, 0.5, -0.25, 0.125, 2.0, -1.0, 0.0]), reals([0.0] * 9)]),
        "set-point-reach-6": uint(7) + uint(2) + sequence([reals([LOWEST] * 9)] * 6),
        "set-point-keep": uint(7) + uint(3),
        "set-point-guide": guide([[0.5, -0.25, 2.0], [0.0, 0.0, 0.0]], [0.125, -0.0625]),
        "set-point-guide-16": guide([[LOWEST] * 3] * 16, [LOWEST] * 16),
        "set-point-pose": pose([0.5, 0.0, -0.25], [0.0, 0.0, 0.0, 1.0], [0.125, 0.0, 0.0, 0.0, 0.0, 0.5], [0.0] * 6,
                               [0.25, 0.0, 0.0]),
        "set-point-pose-longest": pose([LOWEST] * 3, [LOWEST] * 4, [LOWEST] * 6, [LOWEST] * 6, [LOWEST] * 3),
        "stop": uint(8),
        "read-status": uint(9),
        "read-faults": uint(10),
        "clear-faults": uint(11) + uint(300),
        "set-rate-telemetry": uint(12) + uint(0) + uint(1),
        "set-rate-status": uint(12) + uint(1) + uint(100),
        "set-rate-log": uint(12) + uint(2) + uint(65535),
        "set-rate-tips": uint(12) + uint(3) + uint(2),
        "set-rate-grasp": uint(12) + uint(4) + uint(5),
        "set-rate-arm": uint(12) + uint(5) + uint(5),
        "tare": uint(17),
        "grasp": uint(18) + uint(0)
        + plan(BOX, 0.01, 0.1, None, uint(0) + reals([0.2, 0.3, 1.0]), 9.0, True, differential(1)),
        "grasp-normal": uint(18) + uint(0) + plan(BOX, 0.005, 0.125, 0.5, uint(1) + real(2.0), 4.0, False, differential(0)),
        "grasp-pairwise": uint(18) + uint(0)
        + plan(BOX, 0.01, 0.1, 0.75, uint(2) + reals([0.5, 1.0, 1.5]), 9.0, True,
               by_wrench([150.0, 300.0], [0.5, 1.0], 0.03125, False)),
        "grasp-longest": uint(18) + uint(0)
        + plan([([LOWEST] * 3, [LOWEST] * 3)] * 3, LOWEST, LOWEST, LOWEST, uint(2) + reals([LOWEST] * 3), LOWEST, True,
               by_wrench([LOWEST] * 2, [LOWEST] * 2, LOWEST, True)),
        "grasp-move": uint(18) + uint(1) + reals([0.0, 0.0, 0.02]) + reals([0.25, -0.125, 0.0]) + real(1.5),
        "grasp-put-down": uint(18) + uint(2),
        "grasp-open": uint(18) + uint(3),
        "read-grasp": uint(19),
        "impedance": uint(20) + settings(*YIELDING, 1, ARM_ANGLE, 12.0, SENSOR, 1.5, [0.25, 1.5]),
        "impedance-observed": uint(20) + settings(*YIELDING, 1, ARM_ANGLE, 12.0, observer(30.0), 1.5, [0.25, 1.5]),
        "impedance-driven": uint(20) + settings(*YIELDING, 1, uint(1) + byte(2), 12.0, SENSOR, 1.5, [0.25, 1.5]),
        "impedance-printed": uint(20) + settings(*YIELDING, 0, LEAST_MOTION, 12.0, SENSOR, 1.5, [0.25, 1.5]),
        "impedance-longest": uint(20)
        + settings(*[[LOWEST] * 6] * 3, 1, uint(1) + byte(255), LOWEST, observer(LOWEST), LOWEST, [LOWEST] * 2),
        "read-arm": uint(21),
        "take-command": uint(13) + boolean(False),
        "take-command-by-force": uint(13) + boolean(True),
        "release-command": uint(14),
        "export-model": uint(15) + uint(0),
        "export-state": uint(15) + uint(1),
        "read-export": uint(16) + uint(192),
    }
    for name, what in each.items():
        golden("request-" + name, request(9, what))
    golden("request-first-number", request(0, uint(9), client=1))
    golden("request-last-number", request(65535, uint(9), client=0xFFFFFFFF))


FIELDS = """joints chains gravity name origin-translation origin-rotation axis mass center-of-mass inertia
rotor-inertia torque-constant current-limit current-resolution motor-bandwidth motor-delay coulomb viscous
counts-per-turn limit-lower limit-upper limit-velocity limit-torque limit-torque-rate limit-following-error
filter-time proportional integral derivative cutoff servo-inertia bandwidth observer-bandwidth command-timeout
damping supply-min supply-max rest-error
chain-name tip-translation tip-rotation force-resolution torque-resolution saturation force-limit tip-mass
tip-center-of-mass tip-radius""".split()


def refusals():
    def error(joint, field, value, problem):
        return uint(2) + option(None if joint is None else byte(joint)) + uint(field) + real(value) + problem

    each = {
        "schema-mismatch": uint(0) + uint(SCHEMA) + FIRMWARE,
        "no-model": uint(1),
        "model-not-finite": error(None, 2, float("inf"), uint(0)),
        "model-below": error(3, 7, -0.5, uint(1) + real(0.0)),
        "model-not-above": error(15, 20, 1.0, uint(2) + real(1.0)),
        "model-above": error(0, 15, 0.5, uint(3) + real(0.01)),
        "model-not-unit": error(1, 6, 0.5, uint(4)),
        "model-not-physical": error(2, 9, -0.125, uint(5)),
        "model-count": error(None, 1, 8.0, uint(6) + real(9.0)),
        "model-not-unique": error(4, 3, 4.0, uint(7)),
        "model-transfer": uint(3) + uint(192) + uint(220),
        "model-checksum": uint(4) + uint(0x01020304) + uint(0xDEADBEEF),
        "model-unreadable": uint(5) + uint(5000) + uint(4096),
        "wrong-mode-disarmed": uint(6) + DISARMED,
        "wrong-mode-armed-pid": uint(6) + ARMED_PID,
        "wrong-mode-armed-observer": uint(6) + ARMED_OBSERVER,
        "wrong-mode-armed-grasp": uint(6) + ARMED_GRASP,
        "wrong-mode-armed-impedance": uint(6) + ARMED_IMPEDANCE,
        "wrong-mode-fault": uint(6) + FAULT,
        "not-homed": uint(7) + byte(8),
        "faults-unread": uint(8) + uint(3),
        "joint-count": uint(9) + byte(2) + byte(9),
        "not-finite": uint(10) + byte(15),
        "outside-limits": uint(11) + byte(0) + reals([2.0, -1.5, 1.5]),
        "too-fast": uint(12) + byte(1) + reals([9.0, 8.0]),
        "jump": uint(13) + byte(2) + reals([0.5, 0.25]),
        "no-sensors": uint(14),
        "unsafe": uint(15) + fault(10, None, 12.0, 20.0, 1234),
        "commanded": uint(16) + uint(0xDECADE),
        "not-commander": uint(17),
        "stale": uint(18) + uint(12),
        "not-exported": uint(19) + uint(0),
        "tip-count": uint(20) + byte(1) + byte(3),
        "not-a-finger": uint(21) + byte(2),
        "out-of-reach": uint(22) + byte(1) + reals([0.1, 0.0, -0.25]),
        "singular": uint(23) + byte(0),
        "too-much-acceleration": uint(24) + byte(3) + reals([9000.0, 2857.0]),
        "tip-not-finite": uint(25) + byte(2),
        "no-force-sensor": uint(26),
        "not-a-hand": uint(27),
        "not-tared": uint(28) + byte(1),
        "unable-plan-contact": uint(29) + uint(1) + uint(1) + byte(2),
        "unable-plan-no-triangle": uint(29) + uint(1) + uint(2),
        "unable-plan-cannot-grip": uint(29) + uint(1) + uint(3),
        "unable-plan-unbalanced": uint(29) + uint(1) + uint(4) + real(0.25),
        "unable-out-of-reach": uint(29) + uint(2) + byte(1) + reals([0.1, 0.0, -0.25]),
        "unable-not-finite": uint(29) + uint(3),
        "unable-too-fast": uint(29) + uint(4) + reals([0.375, 0.2]),
        "too-much-torque": uint(30) + byte(3) + reals([0.75, 0.6]),
        "not-an-arm": uint(31),
    }
    for number, name in enumerate(PHASES):
        each["unable-busy-" + name] = uint(29) + uint(0) + uint(number)
    for number, name in enumerate(PLAN_FIELDS):
        each["unable-plan-" + name] = uint(29) + uint(1) + uint(0) + uint(number) + reals([2.0, 0.25, 1.0])
    for name, bad in BAD_SETTINGS.items():
        each["settings-" + name] = uint(32) + bad
    for name, bad in ARM_ERRORS.items():
        each["arm-" + name] = uint(33) + bad
    for name, what in each.items():
        golden("board-refused-" + name, reply(9, 1234, uint(2) + what))
    for number, name in enumerate(FIELDS):
        golden("board-refused-field-" + name, reply(9, 1234, uint(2) + error(7, number, 0.5, uint(0))))


def from_board():
    crystal_fault = node_status(FAULT, "hand3", 0x89ABCDEF, 511, 18, False, 0xDECADE, 100000, 23.5)
    nobody = node_status(DISARMED, "", 0, 0, 0, True, None, 0, 0.0)
    full = board_status(1, 2, "panicked at src/main.rs:7", 2048, 16384,
                        frame_counts(1, 2, 3, 4, 5) + uint(6) + uint(7) + uint(8),
                        frame_counts(128, 0, 0, 16384, 0) + uint(0) + uint(0) + uint(4294967295))
    statuses = {
        "nothing": nobody + QUIET_BOARD,
        "fault": crystal_fault + full,
        "watchdog": nobody + board_status(2, 1, "", 0, 0, NO_STATISTICS, NO_STATISTICS),
        "hard-fault": nobody + board_status(0, 3, "w" * 96, 0, 0, NO_STATISTICS, NO_STATISTICS),
        "software": nobody + board_status(0, 4, "", 0, 0, NO_STATISTICS, NO_STATISTICS),
    }
    golden("board-hello", reply(9, 1234, uint(0) + uint(SCHEMA) + IDENTITY))
    golden("board-done", reply(9, 1234, uint(1)))
    golden("board-done-first-number", reply(0, 0, uint(1), client=1))
    golden("board-done-last-number", reply(65535, 4294967295, uint(1), client=0xFFFFFFFF))
    for name, status in statuses.items():
        golden("board-status-" + name, reply(9, 1234, uint(3) + status))
    golden("board-faults-none", reply(9, 1234, uint(4) + uint(0) + sequence([])))
    first = [fault(cause, cause if cause % 2 else None, cause + 0.5, 0.25, 100 + cause) for cause in range(16)]
    golden("board-faults-0-to-15", reply(9, 1234, uint(4) + uint(16) + sequence(first)))
    second = [fault(cause, None, 2.0, 0.0, 0) for cause in range(16, 25)]
    golden("board-faults-16-to-24", reply(9, 1234, uint(4) + uint(4294967295) + sequence(second)))
    golden("board-exported", reply(9, 1234, uint(5) + uint(220) + uint(0xDEADBEEF) + uint(2469)))
    golden("board-chunk", reply(9, 1234, uint(6) + uint(192) + blob([0, 1, 254, 255])))
    golden("board-chunk-long", reply(9, 1234, uint(6) + uint(0) + blob(range(192))))
    golden("board-telemetry-none", uint(1) + telemetry(0, DISARMED, 0, []))
    golden("board-telemetry-pid", uint(1) + telemetry(1234, ARMED_PID, 0, [[0.5, -0.25, 0.5625, 0.03125],
                                                                          [-0.5, 0.25, -0.5625, -0.03125]]))
    golden("board-telemetry-16", uint(1) + telemetry(4294967295, FAULT, 4294967295, [[LOWEST] * 4] * 16))
    tip = reals([0.1, -0.04, 0.0625, 1.5, 0.0, -0.5, 0.0, 0.015625, 0.0]) + boolean(True)
    golden("board-tips", uint(4) + uint(1234) + sequence([tip, reals([0.0] * 9) + boolean(False)]))
    golden("board-tips-6", uint(4) + uint(4294967295) + sequence([reals([LOWEST] * 9) + boolean(True)] * 6))
    golden("board-telemetry-grasp", uint(1) + telemetry(1235, ARMED_GRASP, 0, [[0.5, -0.25, 0.5625, 0.03125]]))
    holding = [[0.09, 0.0, 0.0625, 0.0, 0.375, 0.0, 0.927], [0.5, 0.0, 1.75, 0.0, -0.015625, 0.0],
               [[1.0, 0.0, 0.5], [1.0, 0.0, 0.5], [-1.5, 0.0, 0.75]], 0.4375]
    golden("board-grasp", uint(5) + grasp(1234, 5, None, *holding, 300, False))
    golden("board-grasp-longest", uint(5) + grasp(
        4294967295, 8, FAILURES["no-grip"], [LOWEST] * 7, [LOWEST] * 6, [[LOWEST] * 3] * 3, LOWEST, 65535, True))
    golden("board-read-grasp", reply(9, 1234, uint(7) + grasp(1234, 0, None, *NO_GRASP)))
    for number, name in enumerate(PHASES):
        golden("board-read-grasp-" + name, reply(9, 1234, uint(7) + grasp(1233, number, None, *holding, 0, True)))
    for name, failure in FAILURES.items():
        golden("board-read-grasp-" + name, reply(9, 1234, uint(7) + grasp(1234, 0, failure, *NO_GRASP)))
    golden("board-telemetry-impedance", uint(1) + telemetry(1236, ARMED_IMPEDANCE, 0, [[0.5, -0.25, 0.5625, 0.03125]]))
    pushed = [[0.5, 0.0, -0.25], [0.0, 0.0, 0.0, 1.0], [0.0625, 0.0, 0.0, 0.0, 0.0, -0.125],
              [18.75, 0.0, 0.0, 0.0, 0.0, -1.0], True, 0.15625, 0.25]
    golden("board-arm", uint(6) + arm(1234, *pushed))
    golden("board-arm-longest", uint(6) + arm(4294967295, [LOWEST] * 3, [LOWEST] * 4, [LOWEST] * 6, [LOWEST] * 6, True,
                                              LOWEST, LOWEST))
    golden("board-read-arm", reply(9, 1234, uint(8) + arm(1234, *pushed)))
    golden("board-stream-status", uint(2) + statuses["fault"])
    for number, (name, record) in enumerate(RECORDS.items()):
        golden("board-log-" + name, uint(3) + uint(2468 + number) + record)


RECORDS = {
    "request": uint(0) + request(9, uint(6)),
    "sensors": uint(1) + sensors(1234, 1, 24000, [100, -100], [5, -5]),
    "actuators": uint(2) + actuators(1234, True, [0.25, -0.25]),
    "start": uint(3) + uint(SCHEMA) + IDENTITY + uint(1795000000),
    "state": uint(4) + uint(192) + blob([0, 1, 254, 255]),
    "restore": uint(5) + uint(196) + uint(0xDEADBEEF),
    "gap": uint(6) + uint(300),
}


def plant_link():
    golden("sensors", sensors(1234, 0, 24000, [100, -100, 0], [5, -5, 0]))
    golden("sensors-none", sensors(0, 0, 0, [], []))
    golden("sensors-emergency-stop", sensors(300, 1, 65535, [-2147483648, 2147483647], [-32768, 32767]))
    golden("sensors-16", sensors(4294967295, 255, 65535, [-2147483648] * 16, [-32768] * 16, [[-2147483648] * 6] * 6))
    golden("sensors-forces", sensors(1234, 0, 24000, [100], [5], [[1000, -1000, 0, 7, -7, 63], [0, 0, 0, 0, 0, 1]]))
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
