"""The updates of a robot: the slot state, signatures, and their installation."""
