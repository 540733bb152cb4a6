"""A ROS 2 node that explores: a grid and a pose in, the next goal out.

    python examples/ros2_node.py

Takes `map` (nav_msgs/OccupancyGrid, as slam_toolbox sends it) and `pose` (geometry_msgs/PoseStamped, in the map's
frame); sends `goal_pose` (geometry_msgs/PoseStamped), to which Nav2 drives. A new goal comes with every map. The grid's
origin must not be turned.
"""

import copy
import math

import numpy as np

import jexplore as jx


class Explorer:
    """The decision, and what it needs to know of the way: messages in, goals out."""

    def __init__(self, strategy="closest", **settings):
        self.strategy, self.settings = jx.strategy(strategy), settings
        self.pose, self.driven, self.exhausted, self.memory, self.last = None, [], [], None, None

    def on_pose(self, pose):
        """Note where the robot is, and where it has been."""
        self.pose, here = pose, (pose.pose.position.x, pose.pose.position.y)
        if not self.driven or math.dist(here, self.driven[-1]) > 0.05:
            self.driven.append(here)

    def on_map(self, grid):
        """Return the next goal; None before the first pose, and where nothing is left to explore."""
        if self.pose is None:
            return None
        info, turn, here = grid.info, self.pose.pose.orientation, self.pose.pose.position
        cells = np.array(grid.data, np.int8).reshape(info.height, info.width)
        pose = here.x, here.y, 2 * math.atan2(turn.z, turn.w)
        choice = self.choose(cells, pose, info)
        at = choice.pose and choice.pose[:2]
        if at is not None and at == self.last and math.dist(pose[:2], at) < info.resolution:
            self.exhausted.append(at)  # it is there, and the map shows no more for it
            choice = self.choose(cells, pose, info)
        self.last, self.memory = choice.pose and choice.pose[:2], choice.memory
        if choice.pose is None:
            return None
        goal = copy.deepcopy(self.pose)
        goal.header.frame_id = grid.header.frame_id
        goal.pose.position.x, goal.pose.position.y, heading = choice.pose
        goal.pose.orientation.z, goal.pose.orientation.w = math.sin(heading / 2), math.cos(heading / 2)
        return goal

    def choose(self, cells, pose, info):
        """Ask the strategy."""
        corner = info.origin.position.x, info.origin.position.y
        return jx.next_target(
            cells, pose, cell_m=info.resolution, origin_m=corner, strategy=self.strategy, driven_m=self.driven,
            exhausted_m=self.exhausted, memory=self.memory, **self.settings,
        )  # fmt: skip


def main():
    """Run the node."""
    import rclpy
    from geometry_msgs.msg import PoseStamped
    from nav_msgs.msg import OccupancyGrid

    rclpy.init()
    node, explorer = rclpy.create_node("jexplore"), Explorer()
    publisher = node.create_publisher(PoseStamped, "goal_pose", 1)

    def on_map(grid):
        goal = explorer.on_map(grid)
        if goal is not None:
            publisher.publish(goal)

    node.create_subscription(PoseStamped, "pose", explorer.on_pose, 1)
    node.create_subscription(OccupancyGrid, "map", on_map, 1)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
