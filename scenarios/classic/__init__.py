"""The thesis's own programs, carried over line by line with `eal_actors.classic`."""
