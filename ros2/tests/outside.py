"""Waits for a joint state as another machine would: `outside.py ADDRESS DOMAIN SECONDS` reports whether one
came.

Of this machine's interfaces it uses the one with that address.
"""

import os
import sys

address, domain, patience = sys.argv[1:]
os.environ["CYCLONEDDS_URI"] = f"""<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface address="{address}"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="{address}"/></Peers></Discovery>
</Domain></CycloneDDS>"""

import ros_client  # noqa: E402
import ros_types  # noqa: E402

reader = ros_client.Node(int(domain)).reader("/joint_states", ros_types.JointState)
try:
    ros_client.wait_for("a joint state", lambda: ros_client.take(reader), float(patience))
    print("heard")
except AssertionError:
    print("silence")
