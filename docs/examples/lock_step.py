from eal_actors import Fleet
from eal_actors.managers.config import EALConfigManager

content = {"version": 1, "clock": {"rate": "max"}, "robots": {"scout": {"plugins": {"sim": {"model": "roomba"}}}}}
with Fleet(EALConfigManager.of(content).fleet) as fleet:

    def watch() -> list[bool]:
        bumps = []
        for _ in range(40):
            bumps.append(fleet["scout"]["Bump"].get_value().get().value)
            fleet.clock.sleep(0.05)  # not time.sleep, which the fleet's clock cannot see
        return bumps

    with fleet.tasks() as tasks:  # a task takes part in lock step from its first line
        bumps = tasks.start(watch)
        fleet["scout"]["Base"].send_cmd("f0.5").get()
print(f"{len(bumps.get())} looks, {sum(bumps.get())} bumps")
