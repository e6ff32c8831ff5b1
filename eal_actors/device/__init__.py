"""Resources: data, descriptions, base classes, ports, worlds. Plugin authors import `eal_actors.plugin` instead."""
