"""The robot's own computer as resources."""
