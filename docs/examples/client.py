#!/usr/bin/env python3
"""A small client for a tesaki board, written from docs/protocol.md. Needs nothing but Python.

    client.py unix:///run/hand.sock                      who is there, and how is it?
    client.py tcp://localhost:7400 --move 2 0.4          move joint 2 to 0.4 rad
    client.py /dev/ttyUSB0 --move 2 0.4 --seconds 5
"""

import argparse
import os
import random
import select
import socket
import struct
import sys
import time
import zlib

# ---- postcard and frames -----------------------------------------------------------------------------------


def varint(value):
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes(out) + bytes([value])


def floats(values):
    return varint(len(values)) + struct.pack(f"<{len(values)}f", *values)


def frame(message):
    data = message + zlib.crc32(message).to_bytes(4, "little")
    out = b""
    runs = data.split(b"\0")
    for run in runs:
        while len(run) >= 254:
            out, run = out + b"\xff" + run[:254], run[254:]
        out += bytes([len(run) + 1]) + run
    if runs[-1] and len(runs[-1]) % 254 == 0:
        out = out[:-1]
    return out + b"\0"


def open_frame(data):
    """The message in a frame without its zero; None when it is damaged."""
    out, place = b"", 0
    while place < len(data):
        code = data[place]
        if place + code > len(data):
            return None
        out += data[place + 1 : place + code]
        place += code
        if code < 255 and place < len(data):
            out += b"\0"
    if len(out) < 4 or zlib.crc32(out[:-4]) != int.from_bytes(out[-4:], "little"):
        return None
    return out[:-4]


class Reader:
    def __init__(self, data):
        self.data, self.place = data, 0

    def take(self, length):
        if self.place + length > len(self.data):
            raise ValueError("the message is too short")
        self.place += length
        return self.data[self.place - length : self.place]

    def u8(self):
        return self.take(1)[0]

    def uint(self):
        value = shift = 0
        while True:
            byte = self.u8()
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    def f32(self):
        return struct.unpack("<f", self.take(4))[0]

    def text(self):
        return self.take(self.uint()).decode()

    def option(self, read):
        return read() if self.u8() else None

    def sequence(self, read):
        return [read() for _ in range(self.uint())]

    def end(self):
        if self.place != len(self.data):
            raise ValueError("the message is too long")


# ---- messages ----------------------------------------------------------------------------------------------

HELLO, DISABLE, TAKE_COMMAND, RELEASE_COMMAND, ENABLE, TASK = 0, 1, 3, 4, 10, 11
READ_STATUS, READ_FAULTS, CLEAR_FAULTS, SET_RATE = 14, 15, 16, 17
JOINT_SERVO, OBSERVER, GOAL, TELEMETRY = 0, 1, 0, 0
TASKS = ["joint servo", "grasping", "impedance", "telexistence", "visual approach"]

CAUSES = """command timeout; position limit; velocity limit; following error; encoder jump; encoder stuck;
torque not finite; late tick; sensor count; emergency stop; supply low; supply high; over-current; watchdog
reset; panic; CPU fault; clock fallback; stop; force sensor saturated; force sensor stuck; too much force;
object lost; object moved; tool away; tool turned; runaway; force mismatch; stop gained energy;
sensors silent; crystal stopped; wrong crystal; power stage; force sensor silent; chip supply low;
brown-out reset off""".replace("\n", " ").split("; ")


def read_mode(r):
    mode = r.uint()
    return f"enabled ({TASKS[r.uint()]})" if mode == 1 else {0: "disabled", 2: "fault"}[mode]


def read_fault(r):
    cause, joint, value, limit, tick = r.uint(), r.option(r.u8), r.f32(), r.f32(), r.uint()
    where = "" if joint is None else f", joint {joint}"
    return f"fault {cause} ({CAUSES[cause]}){where}: value {value:.4g}, limit {limit:.4g}, in tick {tick}"


def read_model_error(r):
    joint, field, value, problem = r.option(r.u8), r.uint(), r.f32(), r.uint()
    limit = r.f32() if problem in (1, 2, 3, 6, 10) else None
    return {"joint": joint, "field": field, "value": value, "problem": problem, "limit": limit}


# Lists of refusals: the words and the fields of each, by number.

LIMITS = [
    ("wrong number of joints", ["got:u8", "expected:u8"]),
    ("not a finite number", ["joint:u8"]),
    ("outside the limits", ["joint:u8", "value:f32", "lower:f32", "upper:f32"]),
    ("too fast", ["joint:u8", "value:f32", "limit:f32"]),
    ("too far from the reference", ["joint:u8", "value:f32", "limit:f32"]),
    ("too much acceleration", ["joint:u8", "value:f32", "limit:f32"]),
    ("too much torque", ["joint:u8", "value:f32", "limit:f32"]),
]
JOINT_SERVO_REFUSALS = [
    ("limit", ["limit:limit"]),
    ("wrong number of tips", ["got:u8", "expected:u8"]),
    ("the board cannot compute this chain's angles", ["chain:u8"]),
    ("the tip cannot reach this point", ["chain:u8", "nearest:vector"]),
    ("the chain is nearly singular there", ["chain:u8"]),
    ("the point is not finite", ["chain:u8"]),
]
REFUSALS = [
    ("schema mismatch", ["board:uint", "firmware:version"]),
    ("not in this mode", ["mode:mode"]),
    ("another client commands", ["by:uint"]),
    ("nobody commands: take command first", []),
    ("too late", ["latest:uint"]),
    ("faults not read", ["total:uint"]),
    ("no model: push one first", []),
    ("invalid model", ["error:model_error"]),
    ("model transfer out of step", ["received:uint", "announced:uint"]),
    ("model damaged", ["received:uint", "announced:uint"]),
    ("model unreadable", ["length:uint", "limit:uint"]),
    ("no valid sensor readings", []),
    ("unsafe", ["fault:fault"]),
    ("not homed: run `tesaki home`", ["joint:u8"]),
    ("no force sensor", []),
    ("not exported", ["length:uint"]),
    ("limit", ["limit:limit"]),
    ("no task was enabled", []),
    ("another task runs", ["task:uint"]),
    ("the task refuses", ["why:task_refusal"]),
]


def read_version(r):
    return ".".join(str(part) for part in r.take(3))


def read_entry(refusals):
    """Reads a refusal of this list, as words and fields."""
    def read(r):
        words, fields = refusals[r.uint()]
        values = {}
        for field in fields:
            name, kind = field.split(":")
            values[name] = READERS[kind](r) if kind in READERS else getattr(r, kind)()
        return {"words": words, **values}

    return read


def read_task_refusal(r):
    if r.uint() != JOINT_SERVO:
        raise ValueError("a refusal of a task that this client does not use")
    return read_entry(JOINT_SERVO_REFUSALS)(r)


READERS = {
    "version": read_version, "mode": read_mode, "fault": read_fault,
    "model_error": read_model_error, "limit": read_entry(LIMITS), "task_refusal": read_task_refusal,
    "vector": lambda r: [r.f32() for _ in range(3)],
}


def read_identity(r):
    return {"firmware": read_version(r), "image": r.take(8).hex(), "board": r.take(12).hex(),
            "capabilities": r.uint()}


def read_statistics(r):
    names = ["good", "overlong", "framing", "checksum", "malformed", "receive_overflow", "receive_errors",
             "send_overflow"]
    return {name: r.uint() for name in names}


def read_status(r):
    return {
        "mode": read_mode(r), "model": r.text(), "model_checksum": f"{r.uint():08x}", "homed": r.uint(),
        "faults": r.uint(), "faults_read": bool(r.u8()), "commander": r.option(r.uint), "tick": r.uint(),
        "supply": r.f32(), "identity": read_identity(r),
        "clock": ["crystal", "internal with PLL", "internal"][r.uint()],
        "reset": ["power-on", "watchdog", "panic", "CPU fault", "software", "crystal stopped",
                  "brown-out"][r.uint()],
        "last_words": r.text(), "stack_used": r.uint(), "stack_size": r.uint(),
        "supervisor_link": read_statistics(r), "plant": read_statistics(r),
    }


def read_telemetry(r):
    def joint():
        return {"position": r.f32(), "velocity": r.f32(), "reference": r.f32(), "torque": r.f32()}

    return {"tick": r.uint(), "mode": read_mode(r), "faults": r.uint(), "joints": r.sequence(joint)}


def read_reply(r):
    number = r.uint()
    if number == 0:
        return {"kind": "hello", "schema": r.uint(), "identity": read_identity(r)}
    if number == 1:
        return {"kind": "done"}
    if number == 2:
        return {"kind": "refused", **read_entry(REFUSALS)(r)}
    if number == 3:
        return {"kind": "status", **read_status(r)}
    if number == 4:
        return {"kind": "faults", "total": r.uint(), "faults": r.sequence(lambda: read_fault(r))}
    raise ValueError(f"reply {number} was not asked for")


def read_from_board(data, our_client):
    """(number of the request, reply), or (None, telemetry), or None for what this client has no use for."""
    r = Reader(data)
    number = r.uint()
    if number == 0:
        client, sequence, _tick = r.uint(), r.uint(), r.uint()
        if client != our_client:
            return None  # everybody at the line hears everything
        message = sequence, read_reply(r)
    elif number == 1:
        message = None, read_telemetry(r)
    else:
        return None
    r.end()
    return message


# ---- the line ----------------------------------------------------------------------------------------------


class Line:
    """A socket, or a serial port or pseudo-terminal at 921 600 baud, 8N1."""

    def __init__(self, address):
        self.socket = self.fd = self.serial = None
        if address.startswith("unix://"):
            self.socket = socket.socket(socket.AF_UNIX)
            self.socket.connect(address.removeprefix("unix://"))
        elif address.startswith("tcp://"):
            host, _, port = address.removeprefix("tcp://").rpartition(":")
            self.socket = socket.create_connection((host.strip("[]"), int(port)))
            self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        else:
            try:
                import serial  # pyserial, where it is installed
            except ImportError:
                self.fd = self.open_terminal(address)
            else:
                self.serial = serial.Serial(address, 921600, timeout=0)

    @staticmethod
    def open_terminal(path):
        import termios
        import tty

        fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(fd)
        settings = termios.tcgetattr(fd)
        settings[4] = settings[5] = termios.B921600
        termios.tcsetattr(fd, termios.TCSANOW, settings)
        return fd

    def send(self, data):
        if self.socket:
            self.socket.sendall(data)
        elif self.serial:
            self.serial.write(data)
        else:
            while data:
                data = data[os.write(self.fd, data) :]

    def receive(self, seconds):
        """What is there, waiting for the first byte; nothing when nothing comes."""
        file = self.socket or self.serial or self.fd
        if not select.select([file], [], [], max(0.0, seconds))[0]:
            return b""
        if self.socket:
            data = self.socket.recv(4096)
        elif self.serial:
            return self.serial.read(4096)
        else:
            data = os.read(self.fd, 4096)
        if not data:
            sys.exit("the board hung up")
        return data


class Refused(Exception):
    pass


class Board:
    PATIENCE = 0.04  # s until a request is sent again; less than the command timeout
    TIMEOUT = 2.0  # s until the board is given up

    def __init__(self, line):
        self.line = line
        self.client = random.randrange(1, 1 << 32)
        self.sequence = 0
        self.partial = b""
        self.replies = {}
        self.telemetry = None
        self.damaged = 0
        line.send(b"\0")  # ends whatever was on the line before

    def post(self, number, fields=b""):
        """Sends a request and returns its number and its frame, without waiting for the reply."""
        self.sequence = (self.sequence + 1) & 0xFFFF
        data = frame(varint(self.client) + varint(self.sequence) + varint(number) + fields)
        self.line.send(data)
        return self.sequence, data

    def listen(self, seconds):
        """Takes what comes within this time, or at least a part of it."""
        *frames, self.partial = (self.partial + self.line.receive(seconds)).split(b"\0")
        for data in filter(None, frames):
            message = open_frame(data)
            if message is None:
                self.damaged += 1
                continue
            read = read_from_board(message, self.client)
            if read is None:
                continue
            sequence, content = read
            if sequence is None:
                self.telemetry = content
            else:
                self.replies[sequence] = content

    def ask(self, number, fields=b""):
        """Sends a request, again when nothing comes back, and returns the reply."""
        sequence, data = self.post(number, fields)
        end = time.monotonic() + self.TIMEOUT
        while time.monotonic() < end:
            again = time.monotonic() + self.PATIENCE
            while time.monotonic() < again:
                self.listen(again - time.monotonic())
                if sequence in self.replies:
                    return self.checked(self.replies.pop(sequence))
            self.line.send(data)
        sys.exit(f"no answer within {self.TIMEOUT} s")

    @staticmethod
    def checked(reply):
        if reply["kind"] == "refused":
            details = {name: value for name, value in reply.items() if name not in ("kind", "words")}
            raise Refused(f"refused: {reply['words']} {details or ''}".rstrip())
        return reply

    def hello(self):
        """Agrees with the board on the schema.

        The key is taken from the board: the first hello carries 0, the second what the first reply held. So
        this client claims to fit any board. A real one carries the key for which it was written and stops
        when the board's differs.
        """
        schema = self.ask(HELLO, varint(0))["schema"]
        return self.ask(HELLO, varint(schema))


def show(values):
    for name, value in values.items():
        print(f"  {name:<16} {value}")


def clear_faults(board):
    board.ask(TAKE_COMMAND, b"\0")
    log = board.ask(READ_FAULTS)
    for fault in log["faults"]:
        print(fault)
    board.ask(CLEAR_FAULTS, varint(log["total"]))
    board.ask(RELEASE_COMMAND)


def move(board, index, angle, seconds):
    board.ask(TAKE_COMMAND, b"\0")
    try:
        # Before the task is enabled, as from then on set-points must come.
        goals = [joint["position"] for joint in first_telemetry(board)["joints"]]
        if not 0 <= index < len(goals):
            raise Refused(f"there is no joint {index}; the board's robot has {len(goals)}")
        print(f"joint {index} from {goals[index]:.4f} to {angle:.4f} rad")
        goals[index] = angle
        board.ask(ENABLE, varint(JOINT_SERVO) + varint(OBSERVER))
        try:
            stream(board, goals, index, seconds)
        finally:
            board.ask(DISABLE)
            print("disabled")
    finally:
        try:
            board.ask(RELEASE_COMMAND)
        except Refused as refusal:
            print(f"command not released: {refusal}")


def first_telemetry(board):
    board.telemetry = None
    board.ask(SET_RATE, varint(TELEMETRY) + varint(1))  # every tick
    end = time.monotonic() + 1
    while board.telemetry is None and time.monotonic() < end:
        board.listen(end - time.monotonic())
    if board.telemetry is None:
        raise Refused("no telemetry within 1 s")
    return board.telemetry


def stream(board, goals, index, seconds):
    due = told = start = time.monotonic()
    enabled = False
    while due < start + seconds:
        # Each states the whole aim, so none is sent twice; refusals are looked at.
        board.post(TASK, varint(JOINT_SERVO) + varint(GOAL) + floats(goals))
        due += 0.02
        while time.monotonic() < due:
            board.listen(due - time.monotonic())
        state = board.telemetry
        running = state["mode"].startswith("enabled")
        enabled = enabled or running
        if enabled and not running:
            print(board.ask(READ_FAULTS)["faults"][-1])
            raise Refused(f"the board is in mode {state['mode']}")
        for reply in board.replies.values():
            board.checked(reply)
        board.replies.clear()
        if time.monotonic() > told:
            told += 0.5
            joint = state["joints"][index]
            print(f"  {time.monotonic() - start:5.2f} s  tick {state['tick']}  "
                  f"angle {joint['position']:8.4f} rad  reference {joint['reference']:8.4f} rad  "
                  f"torque {joint['torque']:8.4f} N·m")


def main():
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("address", help="unix://PATH, tcp://HOST:PORT, or a serial port")
    parser.add_argument("--move", nargs=2, metavar=("INDEX", "ANGLE"), help="move joint INDEX to ANGLE [rad]")
    parser.add_argument("--seconds", type=float, default=3.0, help="how long (default: 3)")
    parser.add_argument("--clear-faults", action="store_true", help="show and clear the faults first")
    options = parser.parse_args()
    board = Board(Line(options.address))
    try:
        hello = board.hello()
        print(f"board with schema {hello['schema']:016x}")
        show(hello["identity"])
        if options.clear_faults:
            clear_faults(board)
        print("status")
        show({name: value for name, value in board.ask(READ_STATUS).items() if name != "kind"})
        if options.move:
            move(board, int(options.move[0]), float(options.move[1]), options.seconds)
    except Refused as refusal:
        sys.exit(str(refusal))


if __name__ == "__main__":
    main()
