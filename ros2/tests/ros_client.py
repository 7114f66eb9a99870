"""The other side: what rclpy over rmw_cyclonedds_cpp would do, with Cyclone DDS alone."""

import random
import time
import uuid

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import ros_types as ros

#: What rmw_cyclonedds_cpp sets for ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST.
LOCALHOST = """<CycloneDDS><Domain>
<General><AllowMulticast>false</AllowMulticast>
<Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
<Peers><Peer address="localhost"/></Peers></Discovery></Domain></CycloneDDS>"""

# : Longer than anything here takes, on any working machine.
PATIENCE = 120.0


def wait_for(what, condition, patience=PATIENCE):
    """Waits for `condition`, and returns its first true value."""
    deadline = time.monotonic() + patience
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < deadline, f"waited {patience} s for {what}"
        time.sleep(0.01)


def qos(transient_local=False, depth=None):
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=10)),
        Policy.Durability.TransientLocal if transient_local else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth) if depth else Policy.History.KeepAll,
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
    )


class Node:
    """A participant of a domain."""

    def __init__(self, domain):
        self.participant = DomainParticipant(domain)

    def reader(self, name, kind, transient_local=False, prefix="rt"):
        topic = Topic(self.participant, f"{prefix}{name}", kind)
        return DataReader(self.participant, topic, qos(transient_local))

    def writer(self, name, kind, prefix):
        topic = Topic(self.participant, f"{prefix}{name}", kind)
        return DataWriter(self.participant, topic, qos())


def take(reader):
    """Returns the received messages, without notices that a writer has gone."""
    return [message for message in reader.take(N=10_000) if not isinstance(message, InvalidSample)]


def first(reader, what="a message", accept=lambda message: True):
    """Returns the first message that is accepted."""

    def look():
        return next((message for message in take(reader) if accept(message)), None)

    return wait_for(what, look)


class Client:
    """A client of a service."""

    def __init__(self, node, name, request, reply):
        self.name, self.request, self.seq = name, request, 0
        self.guid = random.getrandbits(64)
        self.replies = node.reader(f"{name}Reply", reply, prefix="rr")
        self.requests = node.writer(f"{name}Request", request, "rq")

    def discover(self):
        wait_for(
            f"the service {self.name}",
            lambda: self.requests.get_matched_subscriptions() and self.replies.get_matched_publications(),
        )

    def send(self, **fields):
        self.discover()
        self.seq += 1
        self.requests.write(self.request(guid=self.guid, seq=self.seq, **fields))
        return self.seq

    def receive(self, seq):
        own = (self.guid, seq)
        return first(self.replies, f"the answer of {self.name}", lambda reply: (reply.guid, reply.seq) == own)

    def call(self, **fields):
        return self.receive(self.send(**fields))


class Trigger(Client):
    def __init__(self, node, name):
        super().__init__(node, name, ros.Trigger_Request, ros.Trigger_Response)

    def ask(self):
        """Sends a request without waiting for the answer; returns its number."""
        return self.send(structure_needs_at_least_one_member=0)

    def __call__(self):
        return self.receive(self.ask())


NOW = ros.Time(0, 0)


def seconds(value):
    return ros.Duration(int(value), round(1e9 * (value - int(value))))


def nanoseconds(stamp):
    return 1_000_000_000 * stamp.sec + stamp.nanosec


def goal(names, points, goal_tolerance=(), goal_time=0.0):
    """Points are times [s] with positions, and perhaps velocities and accelerations."""
    empty = [[], [], []]
    points = [
        ros.JointTrajectoryPoint(*[*lists, *empty][:3], effort=[], time_from_start=seconds(time))
        for time, *lists in points
    ]
    header = ros.Header(NOW, "")
    return ros.FollowJointTrajectory_Goal(
        trajectory=ros.JointTrajectory(header, list(names), points),
        multi_dof_trajectory=ros.MultiDOFJointTrajectory(header, [], []),
        path_tolerance=[],
        component_path_tolerance=[],
        goal_tolerance=list(goal_tolerance),
        component_goal_tolerance=[],
        goal_time_tolerance=seconds(goal_time),
    )


EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 2, 3, 4, 5, 6


class ActionClient:
    """A client of …/follow_joint_trajectory."""

    def __init__(self, node, name):
        part = f"{name}/_action"
        self.send_goal = Client(
            node,
            f"{part}/send_goal",
            ros.FollowJointTrajectory_SendGoal_Request,
            ros.FollowJointTrajectory_SendGoal_Response,
        )
        self.cancel_goal = Client(
            node, f"{part}/cancel_goal", ros.CancelGoal_Request, ros.CancelGoal_Response
        )
        self.get_result = Client(
            node,
            f"{part}/get_result",
            ros.FollowJointTrajectory_GetResult_Request,
            ros.FollowJointTrajectory_GetResult_Response,
        )
        self.feedback = node.reader(f"{part}/feedback", ros.FollowJointTrajectory_FeedbackMessage)
        self.status = node.reader(f"{part}/status", ros.GoalStatusArray, transient_local=True)

    def send(self, goal):
        """Returns whether the goal is accepted, and its ID."""
        goal_id = ros.UUID(list(uuid.uuid4().bytes))
        return self.send_goal.call(goal_id=goal_id, goal=goal).accepted, goal_id

    def ask_goal(self, goal):
        """Sends a goal without waiting for the answer; returns its number."""
        return self.send_goal.send(goal_id=ros.UUID(list(uuid.uuid4().bytes)), goal=goal)

    def ask_result(self, goal_id):
        return self.get_result.send(goal_id=goal_id)

    def result(self, goal_id):
        return self.get_result.call(goal_id=goal_id)

    def cancel(self, goal_id):
        return self.cancel_goal.call(goal_info=ros.GoalInfo(goal_id, NOW))

    def feedback_of(self, goal_id, accept=lambda feedback: True):
        wanted = list(goal_id.uuid)
        message = first(
            self.feedback, "feedback", lambda m: list(m.goal_id.uuid) == wanted and accept(m.feedback)
        )
        return message.feedback
