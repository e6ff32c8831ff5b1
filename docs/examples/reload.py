from pathlib import Path
from tempfile import TemporaryDirectory

from eal_actors import Fleet

LAB = "version: 1\nrobots:\n  desk: {plugins: {sample: {}}}\n"

with TemporaryDirectory() as folder:
    file = Path(folder, "lab.yaml")
    file.write_text(LAB)
    with Fleet.load(file) as fleet:
        fleet["desk"]["SampleResource"].set_value(42).get()
        file.write_text(LAB + "  shelf: {plugins: {sample: {}}}\n")
        print(fleet.reload())  # added shelf
        print(list(fleet), fleet["desk"]["SampleResource"].get_value().get().value)  # desk continued: 42
