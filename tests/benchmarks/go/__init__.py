"""Figures of robots that go where they are sent: `make bench-go`. Each file has a function `run` and its figures."""
