"""The execution of a plan: one thread for any number of robots, and a generator for each task."""
