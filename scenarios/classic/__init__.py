"""The thesis's own programs, ported line by line to `eal_actors.classic`."""
