"""A program that calls the snapshot service of a recorder; its exit status is a key of `snapshot.RESULTS`."""

from __future__ import annotations

import os
import sys

WAIT_S, ANSWER_S = 5.0, 10.0  # for the service to be found, and for its answer


def main(service: str) -> int:
    """Call `service`; return 0, 3 without its type, 4 if nobody offers it, 5 if it failed or gave no answer."""
    try:
        from rosbag2_interfaces.srv import Snapshot
    except ImportError:
        return 3
    import rclpy

    rclpy.init(args=[])
    node = rclpy.create_node(f"snapshot_{os.getpid()}")
    try:
        client = node.create_client(Snapshot, service)
        if not client.wait_for_service(timeout_sec=WAIT_S):
            return 4
        answer = client.call_async(Snapshot.Request())
        rclpy.spin_until_future_complete(node, answer, timeout_sec=ANSWER_S)
        return 0 if answer.done() and answer.result().success else 5
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
