"""Robots that stand anywhere form a shape without collisions: formation.yaml in Python."""

import argparse

from eal_actors import Fleet

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="formation")
    parser.add_argument("--shape", default="circle", choices=["line", "column", "wedge", "circle", "grid"])
    parser.add_argument("--spacing", type=float, default=1.0, help="from neighbour to neighbour, in m")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        formers = [robot for robot in fleet.values() if "Base" in robot]
        fleet.form(formers, arguments.shape, spacing_m=arguments.spacing).get()
        print(f"{len(formers)} robots form a {arguments.shape}")
