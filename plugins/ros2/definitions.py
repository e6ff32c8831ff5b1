"""Interfaces of common packages that rosbags does not ship: the fields alone, without comments and constants.

A type hash depends on the fields only. Those of `NavigateToPose` are of ROS 2 Kilted; for another distribution, give
its own `.action` file in the folder `messages`.
"""

from __future__ import annotations

from typing import Final

SERVICES: Final = {
    "std_srvs/srv/Empty": "---",
    "std_srvs/srv/SetBool": "bool data\n---\nbool success\nstring message",
    "std_srvs/srv/Trigger": "---\nbool success\nstring message",
    "example_interfaces/srv/AddTwoInts": "int64 a\nint64 b\n---\nint64 sum",
    "action_msgs/srv/CancelGoal": (
        "action_msgs/GoalInfo goal_info\n---\nint8 return_code\naction_msgs/GoalInfo[] goals_canceling"
    ),
    "nav_msgs/srv/GetMap": "---\nnav_msgs/OccupancyGrid map",
}
"""Request and response of each service."""

ACTIONS: Final = {
    "nav2_msgs/action/NavigateToPose": (
        "geometry_msgs/PoseStamped pose\nstring behavior_tree\n---\n"
        "uint16 error_code\nstring error_msg\n---\n"
        "geometry_msgs/PoseStamped current_pose\nbuiltin_interfaces/Duration navigation_time\n"
        "builtin_interfaces/Duration estimated_time_remaining\nint16 number_of_recoveries\nfloat32 distance_remaining"
    ),
}
"""Goal, result and feedback of each action."""
