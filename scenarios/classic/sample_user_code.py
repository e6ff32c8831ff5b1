"""The sample user code (Source: thesis §4.7.4): list the resources, read the sample, write it, read it again."""

import sys

from eal_actors.classic import EALconnect, EALdisconnect


def main() -> int:
    """Return 0, or 1 when a call failed."""
    eal = EALconnect()
    if not eal:
        print("Could not connect to EAL", file=sys.stderr)
        return 1

    resourceList = eal.getResourceList()
    while resourceList:
        print(f"Available resource: {resourceList.pop(0)}")

    status = -1
    id = eal.findResource("SampleResource")  # noqa: A001
    if id < 0:
        print("Could not find SampleResource")
    else:
        value = eal.getValue(id)
        if value:
            print(f"SampleResource value = {value.data}")
            value.data = 42
            status = eal.setValue(id, value)

        value = eal.getValue(id)
        if value:
            print(f"SampleResource value is now = {value.data}")

    EALdisconnect(eal)
    return 0 if status > 0 else 1


if __name__ == "__main__":
    sys.exit(main())
