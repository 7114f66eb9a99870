#!/usr/bin/env python3
"""Makes robot.urdf of robots/allegro, robots/leap and robots/inspire from public descriptions, with the thumb
first: its chain must be the first one of a hand that follows an operator. The same parts are dropped as by
robots.py. LEAP V1 KAIZEN has no frames in its tips: they are added in the middle of the soft tips, 7.5 mm
before their end. The thumb of the Inspire hand bends as far as the limits of the joints that follow it allow.
Nothing else is changed.

    pip download --no-deps -d DIR example-robot-data==6.0.0 ghand==0.1.0
    python3 tests/oracles/hands.py DIR
"""

import sys
import textwrap
import zipfile
from pathlib import Path
from xml.dom import expatbuilder

from robots import ERD, elements, end, subtree, write

ROBOTS = Path(__file__).parent / "../../robots"


def make(name, text, thumb, about, tips=(), limits=()):
    document = expatbuilder.parseString(text, namespaces=False)
    root = document.documentElement
    behind = subtree(root, thumb)
    is_thumb = lambda node: (node.getAttribute("name") if node.tagName == "link" else end(node, "child")) in behind
    nodes = [node for node in elements(root) if node.tagName in ("link", "joint")]
    links = {node.getAttribute("name") for node in nodes if node.tagName == "link"}
    children = {end(node, "child") for node in nodes if node.tagName == "joint"}
    base = [node for node in nodes if node.tagName == "link" and node.getAttribute("name") in links - children]
    rest = [node for node in nodes if node not in base]
    for node in elements(root):
        root.removeChild(node)
    for node in base + [n for n in rest if is_thumb(n)] + [n for n in rest if not is_thumb(n)]:
        root.appendChild(node)
    for joint, lower, upper in limits:
        [limit] = [n for node in rest if node.getAttribute("name") == joint for n in node.getElementsByTagName("limit")]
        limit.setAttribute("lower", lower)
        limit.setAttribute("upper", upper)
    about = textwrap.fill(
        f"{about} Stripped: shapes, materials, transmissions, plug-ins, comments; the thumb is first. "
        "Made by tests/oracles/hands.py.",
        width=115,
        subsequent_indent="     ",
        break_on_hyphens=False,
    )
    lines = ['<?xml version="1.0"?>', f"<!-- {about} -->"]
    write(root, 0, lines)
    added = []
    for tip, link, xyz in tips:
        added += [f'  <link name="{tip}"/>', f'  <joint name="to_{tip}" type="fixed">', f'    <parent link="{link}"/>']
        added += [f'    <child link="{tip}"/>', f'    <origin xyz="{xyz}"/>', "  </joint>"]
    lines[-1:-1] = added
    (ROBOTS / name / "robot.urdf").write_text("\n".join(lines) + "\n", encoding="utf-8")


def inspire():
    make(
        "inspire",
        (Path(__file__).parent / "../robots/inspire_right.urdf").read_bytes(),
        "R_thumb_proximal_base",
        "Inspire hand, right. From tests/robots/inspire_right.urdf, which is inspire_right_hand.urdf of the PyPI package "
        "fourier_robot_descriptions-0.2.7; upstream: FFTAI, fourier-robot-descriptions. Licence: Apache-2.0. The thumb bends "
        "from 0 to 0.5 rad in place of -0.1 to 0.6: the joints that follow it cannot go further.",
        limits=[("R_thumb_proximal_pitch_joint", "0", "0.5")],
    )


def main():
    inspire()
    folder = Path(sys.argv[1])
    wheel = next(folder.glob("example_robot_data-6.0.0-*.whl"))
    make(
        "allegro",
        zipfile.ZipFile(wheel).read(ERD + "allegro_hand_description/urdf/allegro_right_hand.urdf"),
        "link_12.0",
        "Wonik Allegro Hand V4, right. From allegro_right_hand.urdf of the PyPI package example_robot_data-6.0.0; "
        "upstream: Wonikrobotics-git/allegro_hand_linux_v4, allegro_hand_description. Licence: BSD, see LICENSE.",
    )
    make(
        "leap",
        zipfile.ZipFile(next(folder.glob("ghand-0.1.0-*.whl"))).read("ghand/assets/models/urdf/ghand_right.urdf"),
        "fpx330_s102_2",
        "LEAP V1 KAIZEN, right. From ghand_right.urdf of the PyPI package ghand-0.1.0. Licence: Apache-2.0, "
        "Copyright 2026 Algomatic Dynamics, Inc. Added: links and joints of the tips.",
        [
            ("thumb_tip", "tip_soft__thumb", "-0.0052 0.027 0"),
            ("index_tip", "tip_soft_2", "0.0068 0.025 0"),
            ("middle_tip", "tip_soft", "0.0068 0.025 0"),
            ("ring_tip", "tip_soft_1", "0.0068 0.025 0"),
        ],
    )


if __name__ == "__main__":
    main()
