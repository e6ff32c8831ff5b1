"""ROS 2 robots over rmw_zenoh, and the fleet as ROS 2 nodes."""
