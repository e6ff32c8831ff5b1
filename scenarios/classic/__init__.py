"""The thesis's own programs on `eal_actors.classic`. Each ends with 0, or with 1 when a call failed."""
