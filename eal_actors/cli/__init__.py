"""The program `eal`: one module for each command."""

from eal_actors.cli.app import app, main

__all__ = ["app", "main"]
