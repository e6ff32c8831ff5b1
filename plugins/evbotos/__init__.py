"""Updates of the machine that runs the robot, over the fleet's network."""
