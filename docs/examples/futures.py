import asyncio

from eal_actors import Fleet
from eal_actors.kernel.errors import DeadlineError, PreemptedError, WaitTimeoutError

with Fleet.load("sim") as fleet:
    base = fleet["roomba-1"]["Base"]
    drive = base.send_cmd("f1", timeout_s=30)
    try:
        drive.get(timeout=0.1)
    except WaitTimeoutError:
        print("still driving:", base.get_status().get() == 1, not drive.done())
    turn = base.send_cmd("r90")  # a newer command takes over
    print(isinstance(drive.exception(), PreemptedError))
    fleet.halt().get()  # so does a halt
    print(isinstance(turn.exception(), PreemptedError))
    print(isinstance(base.send_cmd("f1", timeout_s=0.2).exception(), DeadlineError))  # it has stopped too

    async def turn_and_look() -> float:
        await asyncio.wait_for(base.send_cmd("l45"), 20)  # in real seconds; then it cancels the call
        return (await fleet["roomba-1"]["Pose"].get_value().map(lambda pose: pose.value))[2]

    print(asyncio.run(turn_and_look()))
