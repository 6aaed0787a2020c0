"""The chain in ROS 2: rclpy and Fast DDS, with as much shared memory as pictures need, as its documentation has it.

(With the wheels of PyPI, version 9.1, rclpy's experimental events executor calls nothing back.)"""

import array
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Vector3
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Image

from hierax.runtime.bench.rivals.stopwatch import Stopwatch, look, options

ROLES = ("world", "arm", "spatial")
DEPTH = 10  # of queues
RETRY_S = 0.2
DOMAIN = "87"  # of ROS, so that others' nodes on the machine are not heard

PROFILE = """<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
<transport_descriptors><transport_descriptor><transport_id>shm</transport_id><type>SHM</type>
<segment_size>67108864</segment_size><maxMessageSize>16777216</maxMessageSize></transport_descriptor>
</transport_descriptors><participant profile_name="shm" is_default_profile="true"><rtps>
<userTransports><transport_id>shm</transport_id></userTransports><useBuiltinTransports>false</useBuiltinTransports>
</rtps></participant></profiles>"""


def run_world(node: Any, epochs: int) -> None:
    """Send up, and time what comes down; a first epoch that nobody heard is begun again."""
    stopwatch = Stopwatch(epochs)
    up = node.create_publisher(Vector3, "up1", DEPTH)

    def begin() -> None:
        count, level = stopwatch.begin()
        up.publish(Vector3(x=float(count), y=level))

    def on_down(message: Any) -> None:
        if stopwatch.end(int(message.x)):
            begin()
        elif stopwatch.done:
            stopwatch.tell()
            os._exit(0)

    def retry() -> None:
        if stopwatch.times_us:
            timer.cancel()
        else:
            begin()

    node.create_subscription(Vector3, "down1", on_down, DEPTH)
    timer = node.create_timer(RETRY_S, retry)


def run_arm(node: Any, picture: int) -> None:
    """Pass on."""
    up = node.create_publisher(Vector3, "up2", DEPTH)
    down = node.create_publisher(Vector3, "down1", DEPTH)

    def on_picture(message: Any) -> None:
        look(np.frombuffer(message.data, np.uint8))
        down.publish(Vector3(x=float(message.width), y=0.5 * message.width))

    node.create_subscription(Vector3, "up1", up.publish, DEPTH)
    node.create_subscription(*((Image, "down2", on_picture) if picture else (Vector3, "down2", down.publish)), DEPTH)


def run_spatial(node: Any, picture: int) -> None:
    """Answer."""
    down = node.create_publisher(Image if picture else Vector3, "down2", DEPTH)
    image = Image(data=array.array("B", bytes(picture)))

    def on_up(message: Any) -> None:
        image.width = int(message.x)
        down.publish(image)

    node.create_subscription(Vector3, "up2", on_up if picture else down.publish, DEPTH)


def main() -> None:
    """Be one of the processes; without a role the world, which starts the others."""
    given = options(*ROLES)
    os.environ |= {"ROS_DOMAIN_ID": DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    if not given.role:
        profile = Path("profile.xml").absolute()
        profile.write_text(PROFILE)
        os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] = str(profile)
        for role in ROLES[1:]:
            module = ["-m", "hierax.runtime.bench.rivals.ros2_chain", "--role", role, "--picture", str(given.picture)]
            subprocess.Popen([sys.executable, *module])
    rclpy.init()
    node = Node(given.role or "world")
    if given.role == "arm":
        run_arm(node, given.picture)
    elif given.role == "spatial":
        run_spatial(node, given.picture)
    else:
        run_world(node, given.epochs)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.spin()


if __name__ == "__main__":
    main()
