"""`tesaki-ros2` on a simulated board, as Cyclone DDS sees it.

The programs are named by TESAKI_SIM (host-sim), TESAKI (tesaki) and TESAKI_ROS2 (tesaki-ros2).
TESAKI_ROS2_SECONDS is the minimum time for which joint states are received. No test measures time: a slow
machine only takes longer.
"""

import fcntl
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

import ros_client as client

os.environ["CYCLONEDDS_URI"] = client.LOCALHOST

import ros_types as ros  # noqa: E402
from ros_client import ABORTED, CANCELED, SUCCEEDED, Trigger  # noqa: E402
from proxy import Proxy  # noqa: E402
from ros_client import first, goal, nanoseconds, take, wait_for  # noqa: E402

SIM, TESAKI, ROS2 = (os.environ[name] for name in ("TESAKI_SIM", "TESAKI", "TESAKI_ROS2"))
SECONDS = float(os.environ.get("TESAKI_ROS2_SECONDS", "5"))
HAND = Path(__file__).parents[2] / "robots" / "hand3"
PERIOD = 10_000_000  # ns
ACTION = "/joint_trajectory_controller/follow_joint_trajectory"
SWINGS = ["finger1_swing", "finger2_swing"]


class Served:
    """A simulated board in real time, homed and with a model."""

    def __init__(self, folder):
        self.port = f"unix://{folder}/board"
        command = [SIM, "serve", "--robot", HAND, "--listen", self.port]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for line in self.process.stdout:
            if line.strip().startswith("tesaki home "):
                self.home = line.split()[1:]
            if line.strip().startswith("tesaki tare") or line.strip().startswith("tesaki move"):
                break
        threading.Thread(target=self.process.stdout.read, daemon=True).start()
        self.prepare()

    def prepare(self):
        self.tesaki("model", "push", str(HAND))
        # A busy machine may be late.
        self.tesaki("set", "safety.command_timeout", "1")
        self.tesaki(*self.home)

    def tesaki(self, *arguments):
        command = [TESAKI, "--port", self.port, "--timeout", "60", *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    def type(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def mode(self):
        return json.loads(self.tesaki("--json", "info"))["status"]["node"]["mode"]

    def end(self):
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()
        self.process.wait()


class Program:
    """`tesaki-ros2`, with its output."""

    started = []

    def __init__(self, board, domain, *options, timeout=60):
        command = [ROS2, "--port", board.port, "--robot", HAND, "--domain", str(domain)]
        command += ["--timeout", str(timeout), *options]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        self.started.append(self.process)
        self.lines, self.pauses = [], False
        self.thread = threading.Thread(target=self.listen, daemon=True)
        self.thread.start()
        self.wait_for("Ctrl-C ends")

    def listen(self):
        for line in self.process.stderr:
            self.lines.append(line.rstrip("\n"))
            while self.pauses:
                time.sleep(0.05)

    def wait_for(self, text):
        return wait_for(f"{text!r} in {self.lines}", lambda: next((l for l in self.lines if text in l), None))

    def end(self, number=signal.SIGINT):
        self.process.send_signal(number)
        code = self.process.wait()
        self.thread.join()
        return code


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    board = Served(tmp_path_factory.mktemp("board"))
    yield board
    # Including those of a failed test.
    for process in Program.started:
        process.kill()
    board.end()


@pytest.fixture(scope="module")
def domain():
    # Other tests may run on this machine at the same time.
    return 50 + os.getpid() % 150


@pytest.fixture(scope="module")
def node(domain):
    return client.Node(domain)


@pytest.fixture(scope="module")
def joints(node):
    """Receives joint states from the first one on."""
    reader = node.reader("/joint_states", ros.JointState)
    return Joints(reader)


class Joints:
    def __init__(self, reader):
        self.reader, self.all = reader, []

    def take(self):
        self.all += take(self.reader)
        return self.all

    def now(self):
        """Returns the next joint state, by joint."""
        count = len(self.take())
        wait_for("joint states", lambda: len(self.take()) > count)
        return dict(zip(self.all[-1].name, zip(self.all[-1].position, self.all[-1].velocity)))


@pytest.fixture(scope="module")
def program(board, domain, joints):
    return Program(board, domain)


@pytest.fixture(scope="module")
def log(node):
    return node.reader("/rosout", ros.Log, transient_local=True)


@pytest.fixture(scope="module")
def services(node):
    return {name: Trigger(node, f"/tesaki/{name}") for name in ("enable", "disable", "tare", "clear_faults")}


@pytest.fixture(scope="module")
def action(node):
    return client.ActionClient(node, ACTION)


def names_in_urdf():
    joints = ET.parse(HAND / "robot.urdf").getroot().findall("joint")
    return [joint.get("name") for joint in joints if joint.get("type") != "fixed"]


def hermite(times, positions, velocities):
    """Cubic Hermite splines through points, sampled every millisecond."""
    samples = []
    for k in range(len(times) - 1):
        h = times[k + 1] - times[k]
        s = np.arange(0, 1, 0.001 / h)[:, None]
        p, v = positions[k : k + 2], velocities[k : k + 2]
        samples.append(
            (2 * s**3 - 3 * s**2 + 1) * p[0]
            + (s**3 - 2 * s**2 + s) * h * v[0]
            + (3 * s**2 - 2 * s**3) * p[1]
            + (s**3 - s**2) * h * v[1]
        )
    return np.concatenate([*samples, positions[-1:]])


def test_joint_states_come_with_every_period_and_rising_stamps(program, joints):
    wait_for("joint states", lambda: len(joints.take()) > 100 * SECONDS, client.PATIENCE + 10 * SECONDS)
    assert all(state.name == names_in_urdf() for state in joints.all)
    assert all({len(s.position), len(s.velocity), len(s.effort)} == {9} for s in joints.all)
    stamps = np.array([nanoseconds(state.header.stamp) for state in joints.all])
    steps = np.diff(stamps)
    assert (steps > 0).all() and (steps % PERIOD == 0).all()
    # Since the epoch; the clock of a simulated board on a busy machine is slow.
    assert abs(stamps[0] - time.time_ns()) < 3600e9


def test_who_comes_late_gets_the_description_and_the_fixed_frames(program, domain):
    late = client.Node(domain)
    description = late.reader("/robot_description", ros.String, transient_local=True)
    assert first(description).data == (HAND / "robot.urdf").read_text()
    fixed = first(late.reader("/tf_static", ros.TFMessage, transient_local=True)).transforms
    moving = first(late.reader("/tf", ros.TFMessage)).transforms
    urdf = ET.parse(HAND / "robot.urdf").getroot()
    tree = {j.find("child").get("link"): j.find("parent").get("link") for j in urdf.findall("joint")}
    found = {t.child_frame_id: t.header.frame_id for t in [*fixed, *moving]}
    assert {child: found.get(child) for child in tree} == tree
    assert {t.child_frame_id for t in moving}.isdisjoint(t.child_frame_id for t in fixed)
    for t in [*fixed, *moving]:
        r = t.transform.rotation
        assert abs(np.linalg.norm([r.x, r.y, r.z, r.w]) - 1) < 1e-6


def test_tared_force_sensors_have_wrenches_and_diagnostics_tell_the_model(program, node, services):
    reader = node.reader("/tesaki/wrench/finger1_tip", ros.WrenchStamped)
    answer = services["tare"]()
    assert answer.success and "zeroed" in answer.message
    wrench = first(reader)
    assert wrench.header.frame_id == "finger1_tip"
    force = wrench.wrench.force
    assert np.linalg.norm([force.x, force.y, force.z]) < 0.5
    diagnostics = first(node.reader("/diagnostics", ros.DiagnosticArray))
    values = {value.key: value.value for status in diagnostics.status for value in status.values}
    assert values["model"] == "hand3"


def refusal(action, log, goal):
    """Returns the reason for which a goal is refused."""
    take(log)
    accepted, _ = action.send(goal)
    assert not accepted
    return first(log, "a reason on /rosout", lambda line: "a goal is refused" in line.msg).msg


def test_goals_are_refused_with_the_reason(program, action, services, log):
    good = goal(SWINGS, [(1.0, [0.1, 0.1])])
    assert "call /tesaki/enable first" in refusal(action, log, good)
    answer = services["enable"]()
    assert answer.success and answer.message.startswith("enabled")
    assert services["enable"]().message == "enabled already"
    bad = {
        'hand3 has no joint "thumb"': goal(["thumb"], [(1.0, [0.1])]),
        "finger1_swing: 1.": goal(SWINGS, [(1.0, [1.5, 0.1])]),
        "outside its limits -1 to 1 rad": goal(SWINGS, [(1.0, [1.5, 0.1])]),
        "rad/s is beyond its limit of 6 rad/s": goal(SWINGS, [(0.1, [0.9, 0.1])]),
        "times must increase": goal(SWINGS, [(1.0, [0.1, 0.1]), (1.0, [0.2, 0.2])]),
        "has 1 positions for 2 joints": goal(SWINGS, [(1.0, [0.1])]),
        "still moves at the last point": goal(SWINGS, [(1.0, [0.1, 0.1], [0.0, 1.0])]),
    }
    for reason, wrong in bad.items():
        text = refusal(action, log, wrong)
        assert reason in text, text


def test_a_trajectory_is_followed_and_succeeds(program, node, action, joints):
    references = node.reader("/tesaki/reference", ros.JointState)
    first(references)
    start = [joints.now()[name][0] for name in SWINGS]
    times = [0.0, 0.6, 1.2, 2.0]
    positions = np.array([start, [0.3, -0.1], [0.1, 0.2], [-0.2, 0.25]])
    velocities = np.array([[0.0, 0.0], [-0.1, 0.3], [-0.4, 0.2], [0.0, 0.0]])
    points = [(t, list(p), list(v)) for t, p, v in zip(times[1:], positions[1:], velocities[1:])]
    take(references)
    accepted, goal_id = action.send(goal(SWINGS, points))
    assert accepted
    feedback = action.feedback_of(goal_id)
    assert feedback.joint_names == SWINGS and len(feedback.actual.positions) == 2
    error = np.subtract(feedback.desired.positions, feedback.actual.positions)
    assert np.allclose(error, feedback.error.positions, atol=1e-6)
    result = action.result(goal_id)
    assert (result.status, result.result.error_code) == (SUCCEEDED, 0), result
    assert np.abs([joints.now()[n][0] for n in SWINGS] - positions[-1]).max() < 0.011
    # The references lie on the spline. (When they are there depends on how busy this machine is.)
    index = [names_in_urdf().index(name) for name in SWINGS]
    path = np.array([[state.position[i] for i in index] for state in take(references)])
    # The reference before was where the joints were held, which is not quite where they are.
    positions[0] = path[0]
    spline = hermite(times, positions, velocities)
    away = np.array([np.abs(spline - point).max(axis=1).min() for point in path])
    assert len(path) > 20 and np.ptp(path, axis=0).min() > 0.3
    assert away.max() < 2e-3, away.max()


def test_a_cancelled_goal_ends_at_rest_and_not_at_its_end(program, action, joints):
    accepted, goal_id = action.send(goal(SWINGS, [(8.0, [0.8, -0.8])]))
    assert accepted
    action.feedback_of(goal_id, lambda feedback: feedback.actual.positions[0] > 0.0)
    waiting = action.ask_result(goal_id)
    answer = action.cancel(goal_id)
    assert answer.return_code == 0
    assert [list(goal.goal_id.uuid) for goal in answer.goals_canceling] == [list(goal_id.uuid)]
    result = action.get_result.receive(waiting)
    assert result.status == CANCELED, result
    wait_for("rest", lambda: max(abs(speed) for _, speed in joints.now().values()) < 0.02)
    there = [joints.now()[name][0] for name in SWINGS]
    assert 0.0 < there[0] < 0.79
    for _ in range(20):
        assert np.abs([joints.now()[name][0] for name in SWINGS] - np.array(there)).max() < 0.005
    assert action.cancel(goal_id).return_code == 3  # ended
    assert action.cancel(ros.UUID([7] * 16)).return_code == 2  # unknown


def test_a_goal_takes_the_place_of_the_one_before(program, action):
    accepted, before = action.send(goal(SWINGS, [(8.0, [-0.5, 0.5])]))
    assert accepted
    action.feedback_of(before)
    accepted, after = action.send(goal(SWINGS, [(1.0, [0.1, 0.1], [0.0, 0.0], [0.0, 0.0])]))
    assert accepted
    result = action.result(before)
    assert result.status == CANCELED and "another goal came" in result.result.error_string
    assert action.result(after).status == SUCCEEDED
    last = wait_for("statuses", lambda: take(action.status))[-1]
    assert [goal.status for goal in last.status_list][-2:] == [CANCELED, SUCCEEDED]


def test_a_goal_tolerance_that_is_not_reached_aborts(program, action):
    tolerance = ros.JointTolerance("finger1_swing", 1e-9, 0.0, 0.0)
    accepted, goal_id = action.send(goal(SWINGS, [(0.3, [0.12, 0.12])], [tolerance], goal_time=0.2))
    assert accepted
    result = action.result(goal_id)
    assert (result.status, result.result.error_code) == (ABORTED, -5), result
    assert "finger1_swing is" in result.result.error_string


def test_a_fault_aborts_the_goal_in_words_and_can_be_cleared(program, board, action, services):
    accepted, goal_id = action.send(goal(SWINGS, [(8.0, [-0.5, 0.5])]))
    assert accepted
    action.feedback_of(goal_id)
    board.type("estop on")
    result = action.result(goal_id)
    assert result.status == ABORTED and "emergency stop" in result.result.error_string.lower(), result
    answer = services["enable"]()
    assert not answer.success and "in fault" in answer.message
    board.type("estop off")
    clear, enable = services["clear_faults"], services["enable"]
    wait_for("the end of the fault", lambda: clear().success and enable().success)
    # What is only in the log is not cleared.
    assert services["disable"]().success and clear().message == "no fault to clear"
    assert enable().success


def test_another_program_may_disable_the_board(program, board, action):
    accepted, goal_id = action.send(goal(SWINGS, [(8.0, [-0.5, 0.5])]))
    assert accepted
    action.feedback_of(goal_id)
    board.tesaki("disable")
    result = action.result(goal_id)
    assert result.status == ABORTED, result
    assert "disabled by another program, or reset" in result.result.error_string


def test_ctrl_c_brakes_and_disables_and_every_period_was_received(program, board, action, services, joints):
    assert services["enable"]().success
    accepted, goal_id = action.send(goal(SWINGS, [(8.0, [-0.5, 0.5])]))
    assert accepted
    action.feedback_of(goal_id)
    waiting = action.ask_result(goal_id)
    # It has arrived by then.
    for _ in range(5):
        action.feedback_of(goal_id)
    assert program.end() == 0
    result = action.get_result.receive(waiting)
    assert result.status == ABORTED and "was ended" in result.result.error_string, result
    assert any("was ended: disabled" in line for line in program.lines), program.lines
    assert "disabled" in board.tesaki("--json", "info").lower()
    # Since the first one was received, nothing is missing but what the board did not send.
    published, missing, unsent = (
        int(word) for word in program.lines[-1].replace(";", "").split() if word.isdigit()
    )
    assert unsent == 0
    stamps = [nanoseconds(state.header.stamp) for state in joints.take()]
    gaps = (stamps[-1] - stamps[0]) // PERIOD + 1 - len(stamps)
    lost = max(gaps - missing, 0)
    print(f"{len(stamps)} joint states received of {published} published, {lost} lost;")
    print(f"the board left out {missing} periods")
    assert 0 <= gaps <= missing and len(stamps) <= published


def discover(*services):
    for service in services:
        service.discover()
    # Right after the discovery, RustDDS may lose an answer (one of 150).
    time.sleep(1.0)


def test_the_command_timeout_ends_the_motion_of_a_program_that_is_killed(board, domain):
    program = Program(board, domain)
    # A client that knows the previous program may take it for this one.
    node = client.Node(domain)
    action = client.ActionClient(node, ACTION)
    enable = Trigger(node, "/tesaki/enable")
    discover(enable, action.send_goal)
    assert enable().success
    accepted, goal_id = action.send(goal(SWINGS, [(20.0, [0.8, -0.8])]))
    assert accepted
    action.feedback_of(goal_id)
    program.end(signal.SIGKILL)
    wait_for("the fault", lambda: "CommandTimeout" in board.tesaki("--json", "faults"))
    assert "fault" in board.tesaki("--json", "info").lower()


@pytest.fixture
def anew(board):
    """Starts a program on a board without faults; returns it with its services and its action."""
    board.tesaki("faults", "--clear")
    programs = []

    def start(board, **options):
        # A client would take a program that has ended without a word for this one.
        domain = 200 + (4 * os.getpid() + len(Program.started)) % 30
        programs.append(Program(board, domain, **options))
        node = client.Node(domain)
        names = ("enable", "disable", "tare")
        services = {name: Trigger(node, f"/tesaki/{name}") for name in names}
        action = client.ActionClient(node, ACTION)
        discover(*services.values(), action.send_goal)
        return programs[0], services, action

    yield start
    for program in programs:
        program.end()


def test_a_disable_ends_the_enables_before_it(board, anew):
    _, services, action = anew(board)
    enable, disable, tare = services["enable"], services["disable"], services["tare"]
    assert enable().success and disable().success
    for _ in range(20):
        enabled, disabled = enable.ask(), disable.ask()
        assert disable.receive(disabled).success
        enable.receive(enabled)
        assert board.mode() == "Disabled"
    # All of them come while the node waits for the board.
    board.process.send_signal(signal.SIGSTOP)
    tared = tare.ask()
    time.sleep(0.5)
    enabled, accepted = enable.ask(), action.ask_goal(goal(SWINGS, [(1.0, [0.1, 0.1])]))
    disabled = disable.ask()
    time.sleep(0.5)
    board.process.send_signal(signal.SIGCONT)
    tare.receive(tared)
    assert disable.receive(disabled).success
    answer = enable.receive(enabled)
    assert not answer.success and "asked to disable at the same time" in answer.message
    assert not action.send_goal.receive(accepted).accepted
    assert board.mode() == "Disabled"
    # Nothing of this lasts.
    wait_for("an enabled board", lambda: enable().success)
    assert action.send(goal(SWINGS, [(1.0, [0.1, 0.1])]))[0]
    assert disable().success


def test_a_board_whose_answer_to_enable_is_lost_is_disabled(board, anew, tmp_path):
    proxy = Proxy(board, tmp_path)
    _, services, _ = anew(proxy, timeout=0.5)
    assert services["disable"]().success
    proxy.deaf = 3.0
    answer = services["enable"]()
    # The request has passed.
    assert proxy.deaf == 0.0
    assert not answer.success and "no answer from the board" in answer.message
    # Otherwise it would be enabled until its command timeout, which is a fault.
    assert board.mode() == "Disabled"


def test_a_board_that_does_not_answer_at_the_end_is_told(board, anew):
    program, services, action = anew(board)
    assert services["enable"]().success
    accepted, goal_id = action.send(goal(SWINGS, [(60.0, [0.8, -0.8])]))
    assert accepted
    action.feedback_of(goal_id)
    waiting = action.ask_result(goal_id)
    for _ in range(5):
        action.feedback_of(goal_id)
    board.process.send_signal(signal.SIGSTOP)
    code = program.end()
    board.process.send_signal(signal.SIGCONT)
    assert code == 6, program.lines
    program.wait_for("The board could not be disabled: no answer")
    program.wait_for("Its outputs may still be on")
    result = action.get_result.receive(waiting)
    assert result.status == ABORTED and "may still be on" in result.result.error_string, result


def test_a_fault_that_remains_at_the_end_is_told_and_clearing_it_too(board, anew):
    program, services, _ = anew(board)
    assert services["enable"]().success
    board.tesaki("stop")
    program.wait_for("the board is in fault")
    assert program.end() == 0
    program.wait_for("was ended. The board is in fault, and its outputs are on: it brakes or holds")


def test_a_program_that_was_killed_keeps_command_for_a_moment_only(board, anew):
    victim = Program(board, 30 + os.getpid() % 20)
    other = Trigger(client.Node(30 + os.getpid() % 20), "/tesaki/enable")
    other.discover()
    _, services, _ = anew(board)
    assert other().success
    victim.end(signal.SIGKILL)
    board.tesaki("disable")
    answer = services["enable"]()
    assert answer.success, answer.message


def test_a_disable_ends_an_enable_that_waits_for_command(board, anew):
    domain = 10 + os.getpid() % 20
    commander = Program(board, domain)
    other = Trigger(client.Node(domain), "/tesaki/enable")
    other.discover()
    _, services, _ = anew(board)
    enable, disable = services["enable"], services["disable"]

    def is_overruled():
        wait_for("an enabled board", lambda: other().message.startswith("enabled: "))
        enabled = enable.ask()
        time.sleep(0.3)
        disabled = disable.ask()
        answer = enable.receive(enabled)
        assert disable.receive(disabled).success and not answer.success
        # On a busy machine, the enable may have waited in vain before.
        return "asked to disable at the same time" in answer.message

    wait_for("an enable that is overruled", is_overruled)
    assert board.mode() == "Disabled"
    commander.end()


def test_a_reader_of_the_terminal_that_pauses_stops_nothing(board, anew):
    program, services, _ = anew(board)
    enable = services["enable"]
    assert enable().success
    program.pauses = True
    fcntl.fcntl(program.process.stderr, fcntl.F_SETPIPE_SZ, 4096)
    # Of 32 bytes each: more than this pipe takes, and the buffer of its reader.
    try:
        for _ in range(800):
            assert enable().success
        assert board.mode() != "Fault"
    finally:
        program.pauses = False


def test_the_model_of_another_robot_ends_the_program(board, anew):
    program, _, _ = anew(board)
    try:
        board.tesaki("model", "push", str(HAND.parent / "arm7"))
        assert program.process.wait(60) == 2
        program.thread.join()
        program.wait_for("the board is arm7, and --robot is the folder of hand3")
    finally:
        board.prepare()


def test_a_paused_program_goes_on_or_disables_the_board_and_ends(board, anew):
    program, services, action = anew(board)
    assert services["enable"]().success
    accepted, goal_id = action.send(goal(SWINGS, [(60.0, [0.8, -0.8])]))
    assert accepted
    action.feedback_of(goal_id)

    def is_ended():
        # As a rule, a pause ends the threads of DDS, unless they are not waiting at this moment.
        program.process.send_signal(signal.SIGSTOP)
        time.sleep(0.2)
        program.process.send_signal(signal.SIGCONT)
        try:
            return program.process.wait(timeout=4) is not None
        except subprocess.TimeoutExpired:
            return False

    wait_for("the end of the program", is_ended)
    program.thread.join()
    assert program.process.returncode == 1
    program.wait_for("a thread of DDS has ended")
    program.wait_for("requests no longer arrive")
    # A pause that a busy machine makes longer is a fault.
    assert board.mode() in ("Disabled", "Fault")


def test_a_paused_program_ends_also_while_it_waits_for_its_board(board, anew):
    program, services, _ = anew(board)
    assert services["disable"]().success
    board.process.send_signal(signal.SIGSTOP)
    services["tare"].ask()
    time.sleep(0.5)
    program.process.send_signal(signal.SIGSTOP)
    time.sleep(0.2)
    program.process.send_signal(signal.SIGCONT)
    # It would wait for a minute.
    code = program.process.wait(timeout=30)
    board.process.send_signal(signal.SIGCONT)
    assert code == 1
    program.wait_for("a thread of DDS has ended")


def own_address():
    """The address of an interface to other machines, if there is one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("203.0.113.1", 9))
        except OSError:
            return None
        address = probe.getsockname()[0]
        return None if address.startswith("127.") else address


def test_the_node_is_on_a_network_only_if_that_was_asked_for(board, domain):
    address = own_address()
    if address is None:
        pytest.skip("this machine has no interface but the loopback interface")

    def outside(patience):
        command = [sys.executable, Path(__file__).with_name("outside.py"), address, str(domain), str(patience)]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    program = Program(board, domain, "--network", address)
    assert any(f"announced at {address}: EVERYBODY" in line for line in program.lines)
    assert outside(client.PATIENCE) == "heard"
    program.end()
    program = Program(board, domain)
    assert outside(5) == "silence"
    program.end()
