"""Bridge to a function that is a ROS 2 node; it needs cornercase_client.py beside it, and msgpack.

It publishes time, speed of the ego, gap and closing speed of the leader on the topic /situation, and waits for an
acceleration on /acceleration. A time of 0 means that a new scenario begins.
"""

import math

import rclpy
from cornercase_client import Function, serve
from std_msgs.msg import Float64, Float64MultiArray


class Bridge(Function):
    """Hands one scenario at a time to the node that listens."""

    answers = []

    def step(self, view, dt):
        """Ask the node, and wait for its answer."""
        leader = view.leader
        gap, closing = (math.nan, math.nan) if leader is None else (leader.gap, leader.closing)
        publisher.publish(Float64MultiArray(data=[view.time, view.ego.speed, gap, closing]))
        while not self.answers:
            rclpy.spin_once(node)
        return self.answers.pop()


rclpy.init()
node = rclpy.create_node("cornercase_bridge")
publisher = node.create_publisher(Float64MultiArray, "situation", 1)
node.create_subscription(Float64, "acceleration", lambda message: Bridge.answers.append(message.data), 1)
# What is published before the other node is found would be lost.
while publisher.get_subscription_count() == 0:
    rclpy.spin_once(node, timeout_sec=0.1)
serve(Bridge, one_at_a_time=True)
