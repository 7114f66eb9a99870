"""A simulated board, served by ``host-sim serve``; TESAKI_SIM names the program."""

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import tesaki
from mcap.reader import make_reader
from tesaki import recordings

PROGRAM = os.environ.get("TESAKI_SIM")
pytestmark = pytest.mark.skipif(not PROGRAM, reason="TESAKI_SIM does not name host-sim")


class Served:
    """A simulated board in real time."""

    def __init__(self, path, robot, *options):
        self.port = f"unix://{path}"
        command = [PROGRAM, "serve", "--robot", tesaki.robots() / robot, "--listen", self.port, *options]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.angles = {}
        # If its encoders are relative, it prints how to home the machine where it is.
        for line in self.process.stdout:
            if line.strip().startswith("tesaki home "):
                self.angles = {name: float(angle) for name, angle in (word.split("=") for word in line.split()[2:])}
            if line.strip().startswith("tesaki tare") or line.strip().startswith("tesaki move"):
                break

    def command(self, text):
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()

    def end(self):
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()
        self.process.wait(10)


@pytest.fixture
def serve(tmp_path):
    served = []

    def start(robot="hand3", *options):
        served.append(Served(tmp_path / f"{len(served)}.sock", robot, *options))
        return served[-1]

    yield start
    for one in served:
        one.end()


# A program of its own, which has not loaded NumPy.
FIRST_TELEMETRY = """
import sys
import tesaki

angles = {name: float(angle) for name, angle in (word.split("=") for word in sys.argv[2:])}
with tesaki.Board(sys.argv[1]) as board:
    board.push(tesaki.robots() / "hand3")
    board.home(angles)
    board.enable()
    board.telemetry()
    board.tips()
    board.wait(0.2)
    print(board.faults())
"""


def test_the_first_telemetry_of_an_enabled_board_comes_in_time(serve):
    served = serve()
    angles = [f"{name}={angle}" for name, angle in served.angles.items()]
    run = subprocess.run(
        [sys.executable, "-c", FIRST_TELEMETRY, served.port, *angles], capture_output=True, text=True, timeout=30
    )
    assert run.stdout == "[]\n", run.stdout + run.stderr


def test_a_joint_moves_and_is_recorded(serve, tmp_path):
    served, robot = serve(), tesaki.Robot(tesaki.robots() / "hand3")
    with tesaki.Board(served.port) as board:
        assert board.robot is None and board.joints == []
        with pytest.raises(tesaki.RefusedError, match="^the board refused to enable its outputs: .*; see docs/trouble"):
            board.enable()
        with pytest.raises(TypeError, match="^robot is of type bytes: expected a tesaki.Robot, or the path of a robot"):
            board.push(b"hand3")
        with pytest.raises(tesaki.FileError, match="^cannot read /nowhere/robot.urdf: "):
            board.push("/nowhere")
        assert board.robot is None
        board.push(tesaki.robots() / "hand3")
        assert board.robot == "hand3" and board.joints == robot.joints
        board.push(robot)
        assert board.robot == "hand3" and board.joints == robot.joints
        with pytest.raises(tesaki.RefusedError, match=r"^the board refused to enable its outputs: .*homed.*: call home\(\) first;"):
            board.enable()
        with pytest.raises(ValueError, match="^angles: finger1_swing is missing; all joints are homed at once$"):
            board.home({})
        board.home(served.angles)
        start = board.telemetry()["position"]
        with pytest.raises(tesaki.RefusedError, match=r"^the board refused to move: .*disabled: call enable\(\) first; see"):
            board.move({"finger1_bend": 0.3})
        board.enable()
        assert board.telemetry()["mode"] == "enabled (joint servo)"
        assert board.move({"finger1_bend": 0.3}) <= 0.02
        assert abs(board.telemetry()["position"][1] - 0.3) < 0.025
        board.move({"finger1_bend": -0.1, "finger2_bend": 0.1}, relative=True)
        position = board.telemetry()["position"]
        np.testing.assert_allclose(position[[1, 4]], [0.2, start[4] + 0.1], atol=0.05)
        # A move leaves the goals of the other joints, not only their angles: they still come nearer.
        board.move({"finger3_bend": 0.3}, tolerance=0.1)
        board.move({"finger2_bend": 0.0}, tolerance=0.005)
        np.testing.assert_allclose(board.telemetry()["position"][7], 0.3, atol=0.006)
        board.command("joints", start)
        count = board.record(tmp_path / "r.mcap", 1.0, robot)
        before = (tmp_path / "r.mcap").read_bytes()
        with pytest.raises(tesaki.FileError, match="r.mcap exists: name another recording, or replace it with force=True$"):
            board.record(tmp_path / "r.mcap", 0.1, robot)
        assert (tmp_path / "r.mcap").read_bytes() == before
        count = board.record(tmp_path / "r.mcap", 1.0, robot, force=True)
        with pytest.raises(ValueError, match='^hand3 has no joint "toe"; its joints are finger1_swing, '):
            board.move({"toe": 0.1})
        with pytest.raises(ValueError, match="^finger1_bend: 9 rad is outside its limits -1.2 to 1.7 rad$"):
            board.move({"finger1_bend": 9.0})
        with pytest.raises(tesaki.RefusedError, match="^the board refused to move: finger1_swing: 9 rad is outside"):
            board.command("joints", np.full(9, 9.0))
        with pytest.raises(tesaki.RefusedError, match="^the board refused to open the hand: "):
            board.command("open_hand")
        for wait in (board.wait, lambda within: board.move({}, within=within)):
            with pytest.raises(ValueError, match="^(duration|within) is 10{19}: expected seconds, 0 to 1000000$"):
                wait(1e19)
        with pytest.raises(ValueError, match=r"^tips has the shape \(3, 8\), expected \(3, 9\): position, velocity"):
            board.reach(np.zeros((3, 8)))
        with pytest.raises(ValueError, match=r"^tips has the shape \(2, 9\), expected \(3, 9\): position, velocity"):
            board.reach(np.zeros((2, 9)))
    with pytest.raises(tesaki.BoardError, match="^the board was closed: make another Board$"):
        board.telemetry()
    # Disabled at the end of the block, and free for the next client.
    with tesaki.Board(served.port) as board:
        assert board.telemetry()["mode"] == "disabled"
    joints = recordings.load(tmp_path / "r.mcap")
    assert joints.names == robot.joints and joints.position.shape == (count, 9) and count > 80
    assert (np.diff(joints.time) > 0).all()
    assert joints.position[0, 1] > 0.12 and abs(joints.position[-1, 1] - start[1]) < 0.03
    assert recordings.load(tmp_path / "r.mcap", "/tesaki/reference").position.shape == (count, 9)
    with pytest.raises(ValueError, match="holds nothing on /nothing"):
        recordings.load(tmp_path / "r.mcap", "/nothing")


def test_what_is_no_recording_is_a_file_error(tmp_path):
    (tmp_path / "short.mcap").write_bytes(b"MCAP")
    with pytest.raises(tesaki.FileError, match="cannot be read as MCAP"):
        recordings.load(tmp_path / "short.mcap")
    with pytest.raises(tesaki.FileError, match="nowhere.mcap: No such file or directory$"):
        recordings.load(tmp_path / "nowhere.mcap")
    log = tmp_path / "grip.log"
    log.write_bytes(b"\x09no mcap file at all\x00" * 20)
    with pytest.raises(tesaki.FileError, match="grip.log cannot be read as MCAP .*`tesaki record NAME` writes NAME.mcap"):
        recordings.load(log)


def enable(board, served):
    board.push(tesaki.Robot(tesaki.robots() / "hand3"))
    board.home(served.angles)
    board.enable()


def test_an_exception_disables(serve):
    served = serve()
    with pytest.raises(RuntimeError, match="^on the way$"), tesaki.Board(served.port) as board:
        enable(board, served)
        raise RuntimeError("on the way")
    with tesaki.Board(served.port) as board:
        assert board.telemetry()["mode"] == "disabled" and board.faults() == []


def test_the_others_stay_where_something_else_has_led_them(serve):
    served = serve()
    with tesaki.Board(served.port) as board:
        board.push(tesaki.robots() / "hand3")
        board.home(served.angles)
        board.enable()
        bend, curl = board.joints.index("finger2_bend"), board.joints.index("finger2_curl")
        board.move({"finger1_bend": 0.3, "finger2_bend": 0.3})
        points = np.zeros((9, 3))
        points[:, 0] = board.telemetry()["reference"]
        for _ in range(100):
            points[bend, 0] -= 0.002
            board.stream(points)
            time.sleep(0.01)
        left = board.telemetry()["reference"]
        assert abs(left[bend] - 0.1) < 0.01, left
        board.move({"finger1_bend": 0.35})
        assert abs(board.telemetry()["reference"] - left)[[bend, curl]].max() < 1e-3
        for tolerance in (0.0, -1.0, np.nan, np.inf):
            with pytest.raises(ValueError, match="^tolerance is .*: expected a positive angle in rad$"):
                board.move({"finger1_bend": 0.3}, tolerance=tolerance)


def test_a_board_that_was_reset_is_made_ready_again(serve):
    served, hand = serve(), tesaki.robots() / "hand3"
    with tesaki.Board(served.port) as board:
        # Directly, or after it was told.
        for told in (False, True):
            board.push(hand)
            board.home(served.angles)
            board.enable()
            board.wait(0.1)
            board.disable()
            served.command("reset")
            time.sleep(0.5)
            if told:
                with pytest.raises(tesaki.BoardError, match=r"^the board was reset meanwhile.*: push\(\) it again"):
                    board.home(served.angles)
                assert board.joints == []
        board.push(hand)
        served.command("reset")
        time.sleep(0.5)
        with pytest.raises(tesaki.BoardError, match="^the board was reset meanwhile"):
            board.move({"finger1_bend": 0.3})


def test_a_board_without_a_fault_to_clear_is_disabled_at_the_end(serve):
    served = serve()
    with tesaki.Board(served.port) as board:
        enable(board, served)
        assert board.clear_faults() == []
        board.wait(0.1)
    with tesaki.Board(served.port) as board:
        assert board.telemetry()["mode"] == "disabled" and board.faults() == []


def test_it_is_told_that_a_board_could_not_be_disabled(serve):
    served = serve()
    still_on = "(?s)^The board could not be disabled: no answer .*Its outputs may still be on: press the emergency stop"
    with pytest.raises(RuntimeError, match="^on the way") as caught, tesaki.Board(served.port) as board:
        enable(board, served)
        served.process.send_signal(signal.SIGSTOP)
        raise RuntimeError("on the way")
    served.process.send_signal(signal.SIGCONT)
    # Before Python 3.11 it is a warning.
    assert sys.version_info < (3, 11) or re.match(still_on, *caught.value.__notes__)
    board = tesaki.Board(served.port)
    board.clear_faults()
    board.enable()
    served.process.send_signal(signal.SIGSTOP)
    with pytest.raises(tesaki.BoardError, match=still_on):
        board.close()
    served.process.send_signal(signal.SIGCONT)


def test_an_enabled_board_is_not_taken_over(serve):
    served = serve()
    with tesaki.Board(served.port) as board:
        enable(board, served)
        other = threading.Thread(target=board.wait, args=(4.0,))
        other.start()
        with pytest.raises(tesaki.RefusedError, match=r"take_over=True\) takes command; see"):
            tesaki.Board(served.port)
        with pytest.raises(tesaki.RefusedError, match="^another client commands the board, which is enabled: "):
            tesaki.Board(served.port, take_over=True)
        other.join()


def test_what_another_program_has_enabled_is_not_disabled(serve):
    served = serve()
    with tesaki.Board(served.port) as board:
        enable(board, served)
        # The command timeout stops the hand.
        time.sleep(0.5)
        with tesaki.Board(served.port, take_over=True) as other:
            other.clear_faults()
            other.enable()
            board.close()
            other.wait(0.2)
            assert other.telemetry()["mode"] == "enabled (joint servo)"


def test_a_fault_is_an_exception_with_its_words(serve):
    served = serve()
    with tesaki.Board(served.port) as board:
        enable(board, served)
        board.wait(0.2)
        served.command("estop on")
        words = "^the board is in fault: .*emergency.*\nSee docs/troubleshooting.md"
        with pytest.raises(tesaki.FaultError, match=words) as off:
            board.wait(1.0)
        assert "Its outputs" not in str(off.value)
        served.command("estop off")
        with pytest.raises(tesaki.RefusedError):
            board.enable()
        time.sleep(0.1)
        assert "emergency" in board.clear_faults()[-1]
        board.enable()
        board.wait(0.2)
        # Longer than the command timeout, after which the board may hold the robot.
        time.sleep(0.5)
        words = "(?s)command.*Its outputs may hold the robot; disable\\(\\) switches them off$"
        with pytest.raises(tesaki.FaultError, match=words):
            board.wait(1.0)


def only_replies(path, port):
    """A socket in front of a board's, for one program, which gets the board's replies but none of its
    streams."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen(1)

    def carry():
        program, _ = listener.accept()
        board = socket.socket(socket.AF_UNIX)
        board.connect(port.removeprefix("unix://"))

        def back():
            rest = b""
            with contextlib.suppress(OSError):
                while data := board.recv(4096):
                    *frames, rest = (rest + data).split(b"\0")
                    # Replies have number 0 among a board's messages; COBS encodes a leading zero as 1.
                    program.sendall(b"".join(frame + b"\0" for frame in frames if frame.startswith(b"\x01")))

        threading.Thread(target=back, daemon=True).start()
        with contextlib.suppress(OSError):
            while data := program.recv(4096):
                board.sendall(data)
            board.shutdown(socket.SHUT_RDWR)

    threading.Thread(target=carry, daemon=True).start()
    return f"unix://{path}"


def test_a_board_that_answers_without_readings_has_no_broken_cable(serve, tmp_path):
    served = serve()
    with tesaki.Board(only_replies(tmp_path / "replies.sock", served.port), timeout=0.3) as board:
        for read in (board.telemetry, board.tips):
            begun = time.monotonic()
            with pytest.raises(tesaki.BoardError, match=r"^no telemetry.* within 0\.3 s: the board has no sensor readings"):
                read()
            assert 0.25 < time.monotonic() - begun < 0.9


def test_a_killed_program_stops_the_robot(serve):
    served = serve()
    program = """
import sys, tesaki
board = tesaki.Board(sys.argv[1])
board.push(tesaki.Robot(tesaki.robots() / "hand3"))
board.home({name: float(angle) for name, angle in (word.split("=") for word in sys.argv[2:])})
board.enable()
print("enabled", flush=True)
board.wait(60)
"""
    angles = [f"{name}={angle}" for name, angle in served.angles.items()]
    victim = subprocess.Popen([sys.executable, "-c", program, served.port, *angles], stdout=subprocess.PIPE, text=True)
    assert victim.stdout.readline() == "enabled\n"
    time.sleep(0.3)
    victim.send_signal(signal.SIGKILL)
    victim.wait(10)
    time.sleep(0.5)
    with tesaki.Board(served.port) as board:
        assert board.telemetry()["mode"] == "in fault"
        assert "command" in board.faults()[-1], board.faults()


def messages(path):
    """Returns the messages of a recording by topic."""
    held = {}
    with open(path, "rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            held.setdefault(channel.topic, []).append(message.data)
    return held


def test_an_arm_yields_and_is_led(serve, tmp_path):
    served, arm = serve("arm7"), tesaki.Robot(tesaki.robots() / "arm7")
    soft = tesaki.robots() / "arm7" / "impedances" / "soft.toml"
    with tesaki.Board(served.port) as board:
        board.push(arm)
        if served.angles:
            board.home(served.angles)
        time.sleep(0.6)
        assert board.tips()["tared"].tolist() == [False]
        board.tare()
        assert board.tips()["tared"].tolist() == [True]
        with pytest.raises(ValueError, match="^file is missing: the task impedance needs an impedance file, as in enable"):
            board.enable("impedance")
        board.enable("impedance", file=soft)
        tool = board.task()["Impedance"]
        np.testing.assert_allclose(tool["position"], arm.fk([board.telemetry()["position"]])[0, :3], atol=2e-3)
        target = np.zeros(22, np.float32)
        target[:3], target[3:7], target[19] = tool["position"], tool["rotation"], tool["elbow"]
        # A set-point per tick, along x at 20 mm/s for half a second.
        for step in range(50):
            target[0], target[7] = tool["position"][0] - 0.0002 * (step + 1), -0.02
            board.command("tool", target)
            board.wait(0.01)
        target[7] = 0.0
        board.command("tool", target)
        board.wait(1.0)
        assert abs(board.task()["Impedance"]["position"][0] - tool["position"][0] + 0.01) < 3e-3
        assert board.tips()["force"].shape == (1, 3)
        with pytest.raises(ValueError, match="^robot is hand3, and the board's is arm7: "):
            board.record(tmp_path / "r.mcap", 0.5, tesaki.Robot(tesaki.robots() / "hand3"))
        assert board.record(tmp_path / "r.mcap", 0.5, arm) > 30
        # The recording has begun by then.
        threading.Timer(1.0, served.command, ["estop on"]).start()
        with pytest.raises(tesaki.FaultError, match="emergency"):
            board.record(tmp_path / "fault.mcap", 60.0, arm)
    held = messages(tmp_path / "r.mcap")
    tip = arm.tips[0]
    assert len(held[f"/tesaki/wrench/{tip}"]) > 30 and held["/tf_static"] and len(held["/tf"]) > 30
    assert len(held["/tesaki/task/frame"]) > 10 and len(held["/tesaki/task/target"]) > 10
    assert any(b"the tool is free" in text or b"the tool is in contact" in text for text in held["/rosout"])
    assert any(b"smallest singular value" in values for values in held["/diagnostics"])
    # Complete, with the fault that ended it.
    assert any(b"in fault after enabled" in text for text in messages(tmp_path / "fault.mcap")["/rosout"])


def test_no_board_and_wrong_arguments():
    with pytest.raises(tesaki.BoardError, match="/nowhere.sock"):
        tesaki.Board("unix:///nowhere.sock")
    with pytest.raises(ValueError, match="^port: "):
        tesaki.Board("")
    with pytest.raises(ValueError, match="^timeout is -1: expected seconds, 0 to 1000000$"):
        tesaki.Board(timeout=-1)


def test_stubs_name_what_there_is():
    """The type stubs have the classes, methods and arguments of the module."""
    import ast
    import inspect
    from pathlib import Path

    from tesaki import _tesaki

    stubs = ast.parse((Path(tesaki.__file__).parent / "_tesaki.pyi").read_text())
    described = {node.name: node for node in stubs.body if isinstance(node, (ast.ClassDef, ast.FunctionDef))}
    assert set(described) == {name for name in vars(_tesaki) if not name.startswith("_")}
    for name, node in described.items():
        if isinstance(node, ast.FunctionDef):
            continue
        own = vars(getattr(_tesaki, name))
        methods = {part.name: part for part in node.body if isinstance(part, ast.FunctionDef)}
        hidden = {"__module__", "__doc__", "__new__", "__repr__", "__weakref__"}
        assert set(methods) - {"__init__"} == set(own) - hidden, name
        for method, stub in methods.items():
            found = own.get(method)
            if callable(found) and method != "__init__":
                arguments = [argument.arg for argument in stub.args.args + stub.args.kwonlyargs]
                assert list(inspect.signature(found).parameters) == arguments, f"{name}.{method}"
                assert method.startswith("_") or found.__doc__, f"{name}.{method} has no docstring"
