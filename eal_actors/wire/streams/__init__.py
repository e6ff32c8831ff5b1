"""Streams of values: the reader of a controller and the publisher of a robot."""
