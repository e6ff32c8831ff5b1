"""`python -m eal_actors` is `eal`."""

from eal_actors.cli import main

main()
