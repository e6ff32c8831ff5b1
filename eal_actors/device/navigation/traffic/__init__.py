"""Traffic: paths for a whole fleet that neither collide nor deadlock, and the order in which their moves may happen."""
